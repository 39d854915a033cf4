import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from visualrhp.embodiment.robot_model import Mounting, robot_spec
from visualrhp.embodiment.simulated_cell.robot_meshes import coarse_meshes, merged, use_coarse_meshes


def test_what_moves_and_what_collides_stays_the_same() -> None:
    fine = robot_spec(Mounting()).compile()
    spec = robot_spec(Mounting())
    use_coarse_meshes(spec)
    coarse = spec.compile()
    for name in ("body_mass", "body_inertia", "body_ipos", "body_pos", "body_quat", "actuator_gainprm"):
        assert np.allclose(getattr(fine, name), getattr(coarse, name), atol=1e-9), name
    assert coarse.mesh_facenum.sum() < 0.3 * fine.mesh_facenum.sum()
    assert fine.ngeom == coarse.ngeom


def test_hulls_are_those_of_the_original_meshes() -> None:
    meshes, inertias = coarse_meshes()
    assert inertias["gripper/base"].mass == pytest.approx(0.777441)
    base = meshes["gripper/base"]
    volume = ConvexHull(base.hull).volume
    assert volume == pytest.approx(ConvexHull(base.vertices).volume, rel=0.1)
    assert len(base.hull) < 1000


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000))
def test_merged_meshes_stay_close(seed) -> None:
    rng = np.random.default_rng(seed)
    vertices, grid = rng.uniform(-0.05, 0.05, (200, 3)), 0.01
    faces = rng.integers(0, 200, (300, 3))
    points, triangles = merged(vertices, faces, grid)
    assert len(points) <= len(vertices)
    assert triangles.max() < len(points)
    assert (triangles >= 0).all()
    assert (np.sort(triangles, axis=1)[:, 1:] > np.sort(triangles, axis=1)[:, :-1]).all(), "no triangle vanishes"
    distances = np.linalg.norm(points[:, None] - vertices, axis=2).min(axis=1)
    assert distances.max() <= np.sqrt(3.0) * grid


def test_a_square_is_unchanged_by_a_fine_grid() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    points, triangles = merged(vertices, faces, 0.01)
    corners = {tuple(point) for point in points.tolist()}
    assert corners == {tuple(vertex) for vertex in vertices.tolist()}
    areas = np.cross(
        points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    )
    assert areas[:, 2].tolist() == [1.0, 1.0], "and the orientation, too"

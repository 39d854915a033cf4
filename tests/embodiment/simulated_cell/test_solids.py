import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from visualrhp.embodiment.simulated_cell.solids import SILHOUETTE_TOLERANCE, Revolution, bottle, box, cup, fruit

SOLIDS = {
    "fruit": fruit(0.035, 0.9),
    "cup": cup(0.09, 0.04),
    "bottle": bottle(0.033, 0.18),
    "box": box(0.04, 0.025, 0.07),
}
UPRIGHT = np.eye(3)
LYING = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
ROTATIONS = st.integers(0, 10_000).map(
    lambda seed: Rotation.from_quat(np.random.default_rng(seed).standard_normal(4)).as_matrix()
)


def polygon(solid, rotation):
    return shapely.Polygon(solid.silhouette(rotation))


def test_silhouettes_of_upright_solids_are_known_figures() -> None:
    assert polygon(SOLIDS["fruit"], UPRIGHT).area == pytest.approx(np.pi * 0.035**2, rel=0.02)
    assert polygon(SOLIDS["cup"], UPRIGHT).area == pytest.approx(np.pi * 0.04**2, rel=0.02)
    assert polygon(SOLIDS["bottle"], UPRIGHT).area == pytest.approx(np.pi * 0.033**2, rel=0.02)
    assert polygon(SOLIDS["box"], UPRIGHT).bounds == pytest.approx((-0.04, -0.025, 0.04, 0.025))


def test_silhouettes_of_lying_solids_are_their_profiles() -> None:
    for name in ("cup", "bottle"):
        solid = SOLIDS[name]
        z, radius = np.array(solid.profile).T
        area = 2.0 * np.sum(0.5 * np.diff(z) * (radius[1:] + radius[:-1]))
        assert polygon(solid, LYING).area == pytest.approx(area, rel=0.01)
        low_x, low_y, high_x, high_y = polygon(solid, LYING).bounds
        assert high_x - low_x == pytest.approx(solid.height, abs=1e-3)
        assert high_y - low_y == pytest.approx(2.0 * solid.radius, abs=1e-3)
    assert not polygon(SOLIDS["bottle"], LYING).equals(polygon(SOLIDS["bottle"], LYING).convex_hull), "it has a neck"


@pytest.mark.parametrize("name", SOLIDS)
@settings(max_examples=5, deadline=None)
@given(rotation=ROTATIONS)
def test_a_silhouette_holds_what_is_seen_of_the_mesh(name, rotation) -> None:
    """The same quantity another way: the union of the projected triangles."""
    solid = SOLIDS[name]
    mesh = solid.mesh
    seen = (mesh.vertices @ rotation.T)[:, :2]
    triangles = shapely.polygons(seen[mesh.faces])
    union = shapely.union_all(shapely.buffer(triangles[shapely.area(triangles) > 1e-10], 1e-6))
    silhouette = polygon(solid, rotation)
    assert silhouette.buffer(2.0 * SILHOUETTE_TOLERANCE).contains(union)
    assert union.buffer(2.0 * SILHOUETTE_TOLERANCE).contains(silhouette)


@pytest.mark.parametrize("name", SOLIDS)
@settings(max_examples=20, deadline=None)
@given(rotation=ROTATIONS)
def test_a_solid_rests_on_its_lowest_point(name, rotation) -> None:
    solid = SOLIDS[name]
    lowest = (solid.mesh.vertices @ rotation.T)[:, 2].min()
    assert solid.clearance_below(rotation) == pytest.approx(-lowest, abs=2e-4)


@pytest.mark.parametrize("name", SOLIDS)
def test_meshes_are_closed_and_face_outwards(name) -> None:
    """The signed volume of the triangles is that of the solid."""
    mesh = SOLIDS[name].mesh
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    volume = np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0
    solid = SOLIDS[name]
    if isinstance(solid, Revolution):
        z, radius = np.array(solid.profile + solid.inside).T
        expected = np.sum(np.pi / 3.0 * np.diff(z) * (radius[1:] ** 2 + radius[1:] * radius[:-1] + radius[:-1] ** 2))
    else:
        expected = 8.0 * np.prod(solid.half_extents)
    assert volume == pytest.approx(expected, rel=0.02)
    assert mesh.texture_coordinates.min() >= 0.0
    assert mesh.texture_coordinates.max() <= 1.0


def test_pieces_of_a_solid_are_convex_and_complete() -> None:
    for solid in SOLIDS.values():
        if isinstance(solid, Revolution):
            assert solid.pieces[0][0] == 0
            assert solid.pieces[-1][1] == len(solid.profile) - 1
            assert all(one[1] == other[0] for one, other in zip(solid.pieces, solid.pieces[1:], strict=False))
            for piece in solid.pieces:
                z, radius = solid.rings[piece[0] : piece[1] + 1].T
                section = shapely.Polygon(np.concatenate([np.stack([radius, z], 1), np.stack([-radius, z], 1)[::-1]]))
                assert section.area == pytest.approx(section.convex_hull.area, rel=1e-6)

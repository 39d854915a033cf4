import numpy as np
import pytest

from tests.embodiment.simulated_cell.cells import APPLE, BOTTLE, BOX, CUP, EVERYTHING, LYING_BOTTLE, ORANGE
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.simulated_cell.model import TIME_STEP, cell_model
from visualrhp.embodiment.simulated_cell.objects import volume
from visualrhp.embodiment.simulated_cell.task import CellTask

mujoco = robot_package("mujoco")
POSES = [[0.1, 0.1, 0.3], [0.1, -0.1, 0.0], [0.0, 0.18, 0.0], [0.0, -0.18, 0.0], [0.2, 0.0, 1.57], [-0.05, 0.1, 0.4]]


@pytest.fixture(scope="module")
def model():
    return cell_model(CellTask(EVERYTHING, POSES))  # pyright: ignore[reportArgumentType]


def test_masses_are_those_of_the_objects(model) -> None:
    for number, thing in enumerate(EVERYTHING):
        assert model.body(f"object_{number}").mass[0] == pytest.approx(thing.mass, rel=0.02)


def test_inertias_are_those_of_solids(model) -> None:
    """Of a ball 2/5 m r^2; of a box m (a^2 + b^2) / 3; of a cup about its axis from the integral of r^4."""
    ball = model.body("object_1").inertia
    assert ball == pytest.approx([0.4 * ORANGE.mass * 0.036**2] * 3, rel=0.01)
    a, b, c = BOX.solid.half_extents
    expected = BOX.mass / 3.0 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    assert sorted(model.body("object_5").inertia) == pytest.approx(sorted(expected), rel=0.01)
    z = np.linspace(0.0, 0.09, 2001)
    radius = 0.038 * (0.8 + 0.2 * z / 0.09)
    about_axis = CUP.mass / volume(CUP.solid) * np.trapezoid(0.5 * np.pi * radius**4, z)
    assert min(model.body("object_2").inertia) == pytest.approx(about_axis, rel=0.03)


def test_objects_stand_on_the_table(model) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for number, thing in enumerate(EVERYTHING):
        rotation = data.body(f"object_{number}").xmat.reshape(3, 3)
        assert data.body(f"object_{number}").xpos[2] == pytest.approx(thing.solid.clearance_below(rotation), abs=1e-9)
        assert rotation == pytest.approx(thing.rotation(POSES[number][2]), abs=1e-9)
    touching = {model.geom(g).name for contact in data.contact for g in (contact.geom1, contact.geom2)}
    assert "table" in touching
    assert all(contact.dist > -1e-4 for contact in data.contact), "nothing overlaps"


def test_parts_of_the_robot_do_not_collide_with_each_other(model) -> None:
    robot = [g for g in range(model.ngeom) if not model.geom(g).name.startswith(("object", "table", "floor"))]
    for one in robot:
        assert not any(model.geom_contype[one] & model.geom_conaffinity[other] for other in robot)
    apple = model.geom("object_0_0").id
    pad = model.geom("gripper/left_pad1").id
    assert model.geom_contype[pad] & model.geom_conaffinity[apple]
    assert model.geom_contype[apple] & model.geom_conaffinity[model.geom("table").id]


def test_the_model_is_a_function_of_the_task(model) -> None:
    again = cell_model(CellTask(EVERYTHING, POSES))  # pyright: ignore[reportArgumentType]
    for name in ("body_mass", "geom_size", "geom_friction", "mesh_vert", "tex_data", "light_dir", "cam_pos"):
        assert np.array_equal(getattr(model, name), getattr(again, name)), name
    assert model.opt.timestep == TIME_STEP


def test_friction_is_that_of_the_object(model) -> None:
    """MuJoCo takes the larger of two bodies; the table's is the smaller."""
    for number, thing in enumerate(EVERYTHING):
        geoms = [
            g for g in range(model.ngeom) if model.geom(g).name.startswith(f"object_{number}") and model.geom_contype[g]
        ]
        assert geoms
        assert {float(model.geom_friction[g, 0]) for g in geoms} == {thing.friction}
        assert thing.friction > model.geom("table").friction[0]


def test_a_ball_is_a_ball_and_an_apple_an_ellipsoid() -> None:
    model = cell_model(CellTask((ORANGE, APPLE, BOTTLE, LYING_BOTTLE), POSES[:4]))  # pyright: ignore[reportArgumentType]
    kinds = [mujoco.mjtGeom(int(model.geom(f"object_{number}_0").type[0])).name for number in range(3)]
    assert kinds == ["mjGEOM_SPHERE", "mjGEOM_ELLIPSOID", "mjGEOM_MESH"]
    assert model.geom("object_0_0").size[0] == pytest.approx(0.036)
    assert model.geom("object_1_0").size == pytest.approx([0.034, 0.034, 0.9 * 0.034])

import numpy as np
import pytest
import shapely

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.reach import ReachMap
from visualrhp.embodiment.robot_model import CELL_GRIPPER
from visualrhp.embodiment.simulated_cell.sampling import CellDistribution, sample_cell
from visualrhp.embodiment.simulated_cell.task import TABLE_SIDE
from visualrhp.errors import ConfigError
from visualrhp.parameters import validated
from visualrhp.streams import Split

COUNT = 25


def cells(**parameters):
    distribution = CellDistribution(**parameters)
    return [sample_cell(distribution, 3, Split.EVALUATION, index) for index in range(COUNT)]


def outlines_of(task) -> list[shapely.Polygon]:
    placed = zip(task.objects, task.poses, strict=True)
    return [shapely.Polygon(thing.solid.silhouette(thing.rotation(pose[2])) + pose[:2]) for thing, pose in placed]


def test_a_cell_is_a_function_of_its_arguments() -> None:
    distribution = CellDistribution()
    one, again = (sample_cell(distribution, 1, Split.EVALUATION, 5) for _ in range(2))
    assert one == again
    assert hash(one) == hash(again)
    others = [(2, Split.EVALUATION, 5), (1, Split.TUNING, 5), (1, Split.EVALUATION, 6)]
    assert all(sample_cell(distribution, *other) != one for other in others)


def test_looks_do_not_change_the_layout() -> None:
    plain, varied = (
        sample_cell(CellDistribution(varied_look=look, camera_offset=offset), 1, Split.EVALUATION, 2)
        for look, offset in ((False, 0.0), (True, 0.02))
    )
    assert np.array_equal(plain.poses, varied.poses)
    assert plain.look != varied.look
    assert plain.camera != varied.camera


def test_objects_stand_apart_on_the_table_and_the_gripper_within_reach() -> None:
    half, reach = 0.5 * TABLE_SIDE, ReachMap.load()
    table = shapely.box(-half, -half, half, half).buffer(-0.0075)
    for task in cells(num_objects=(2, 7)):
        bodies = outlines_of(task)
        assert 2 <= len(bodies) <= 7
        bodies += [shapely.Polygon(part) for part in CELL_GRIPPER.outlines(task.gripper_pose, CELL_GRIPPER.stroke)]
        for number, body in enumerate(bodies[: len(task.objects)]):
            assert table.contains(body)
            assert all(body.distance(other) > 0.0075 for other in bodies[number + 1 :])
        centre = shapely.get_coordinates(bodies[0].convex_hull.centroid)[0]
        assert np.hypot(*(centre - task.target.position)) > task.target.radius
        assert reach.contains(task.gripper_pose)
        x, y, theta = task.gripper_pose
        assert half - 0.06 < max(abs(x), abs(y)) < half
        assert x * np.cos(theta) + y * np.sin(theta) < 0.0, "heads inwards"


def test_kinds_and_sizes_are_those_asked_for() -> None:
    drawn = cells(num_objects=3, desired=(Kind.ORANGE,), kinds=(Kind.BOX, Kind.CUP))
    assert {task.objects[0].kind for task in drawn} == {Kind.ORANGE}
    assert {thing.kind for task in drawn for thing in task.objects[1:]} == {Kind.BOX, Kind.CUP}
    large = cells(num_objects=1, desired=(Kind.APPLE,), desired_size="large")
    assert all(task.objects[0].solid.radius > CELL_GRIPPER.stroke / 2.0 for task in large)


def test_layouts() -> None:
    half = 0.5 * TABLE_SIDE
    for task in cells(layout="target_at_edge"):
        assert half - task.target.radius - np.abs(task.target.position).max() <= 0.03
    for task in cells(layout="object_in_corner", num_objects=2):
        centre = shapely.get_coordinates(outlines_of(task)[0].convex_hull.centroid)[0]
        assert np.hypot(*(half - np.abs(centre))) <= 0.0901
    for task in cells(layout="object_behind", num_objects=4):
        centre = shapely.get_coordinates(outlines_of(task)[0].convex_hull.centroid)[0]
        between = shapely.LineString([task.gripper_pose[:2], centre])
        assert any(between.intersects(body.convex_hull) for body in outlines_of(task)[1:])


def test_without_errors_the_camera_is_the_nominal_one() -> None:
    from visualrhp.embodiment.simulated_cell.task import nominal_camera

    distribution = CellDistribution(camera_offset=0.0, camera_tilt=0.0, focal_error=0.0, lens_distortion=0.0)
    camera = sample_cell(distribution, 0, Split.EVALUATION, 0).camera
    assert np.allclose(camera.pose, nominal_camera().pose, atol=1e-12)
    assert np.allclose(camera.intrinsics, nominal_camera().intrinsics)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"num_objects": (3, 2)}, "the smaller bound comes first"),
        ({"num_objects": 0}, "at least 1"),
        ({"desired": ("pear",)}, "desired"),
        ({"kinds": ()}, "kinds"),
        ({"layout": "object_behind", "num_objects": 1}, "needs an obstacle"),
        ({"friction": (0.0, 0.3)}, "above 0"),
        ({"camera_blur": -1.0}, "camera_blur"),
        ({"target_radius": 0.25}, "target_radius"),
    ],
)
def test_parameters_that_cannot_be_are_refused(parameters, message) -> None:
    with pytest.raises(ConfigError, match=message):
        CellDistribution(**parameters)


def test_a_distribution_can_come_from_a_configuration() -> None:
    import dataclasses
    import json

    content = json.loads(json.dumps(dataclasses.asdict(CellDistribution(desired=(Kind.ORANGE,)))))
    assert validated(CellDistribution, content) == CellDistribution(desired=(Kind.ORANGE,))


def test_what_cannot_be_sampled_is_one_sentence() -> None:
    with pytest.raises(ConfigError, match="No cell was found"):
        sample_cell(CellDistribution(num_objects=2, clearance=0.24), 0, Split.EVALUATION, 0)
    with pytest.raises(ConfigError, match="index=-1"):
        sample_cell(CellDistribution(), 0, Split.EVALUATION, -1)

"""Images and joints become scenes and states: synthetic views, with a segmenter that knows what is in them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import shapely

from tests.embodiment.seen_bodies import (
    CIRCLE,
    Body,
    box,
    cup,
    detection,
    fruit,
    lying_bottle,
    painted,
    standing_bottle,
    top_camera,
)
from visualrhp.embodiment.arm_silhouette import arm_mask
from visualrhp.embodiment.desired import DesiredObject
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.perception import Perception, PerceptionParameters, View
from visualrhp.embodiment.robot_cell import ArmState, CameraFrame, GripperState
from visualrhp.embodiment.robot_model import HOME, Mounting
from visualrhp.embodiment.segmentation import Detection
from visualrhp.errors import PerceptionError
from visualrhp.scene.start import check_start
from visualrhp.simulation import rules

CAMERA = top_camera(focal_length=1000.0)
TARGET = np.array([0.12, 0.14])


@dataclass
class Tool:
    x: float = -0.15
    y: float = -0.15
    theta: float = 0.0


@dataclass
class Arm:
    """Kinematics that are told where the gripper is; the joints do not matter."""

    mounting: Mounting = field(default_factory=lambda: Mounting(x=-0.9))
    tool: Tool = field(default_factory=Tool)

    def forward(self, joints, /) -> Tool:
        return self.tool


@dataclass
class World:
    """A surface with bodies, as the camera sees it, and perception of it."""

    bodies: list[Body]
    desired: DesiredObject = field(default_factory=DesiredObject)
    settings: PerceptionParameters = field(default_factory=PerceptionParameters)
    arm: Arm = field(default_factory=Arm)
    missed: set[int] = field(default_factory=set)
    extra: list[Detection] = field(default_factory=list)
    opening: float = 0.085
    closed: bool = False
    time_s: float = 0.0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(0)
        self.perception = Perception(CAMERA, self, self.arm, self.desired, settings=self.settings)

    def segment(self, image) -> list[Detection]:
        arm = arm_mask(CAMERA, HOME, self.opening, self.arm.mounting, margin=0.0)
        seen = [detection(CAMERA, body, arm) for number, body in enumerate(self.bodies) if number not in self.missed]
        return [each for each in seen if each.mask.sum() > 30] + self.extra

    def picture(self) -> np.ndarray:
        image = np.full((CAMERA.height, CAMERA.width, 3), (150.0, 140.0, 120.0))
        disc = CAMERA.project(np.column_stack([TARGET + 0.07 * CIRCLE, np.zeros(len(CIRCLE))]))
        image[painted(CAMERA, shapely.Polygon(disc))] = (40.0, 180.0, 90.0)
        return np.clip(image + self.rng.normal(0.0, 3.0, image.shape), 0, 255).astype(np.uint8)

    def painted(self) -> np.ndarray:
        """The picture with the bodies in it."""
        image = self.picture()
        for number, body in enumerate(self.bodies):
            image[detection(CAMERA, body).mask] //= 2 + number % 2
        return image

    def view(self, image=None) -> View:
        self.time_s += 0.1
        frame = CameraFrame(self.picture() if image is None else image, self.time_s)
        arm = ArmState(np.array(HOME), np.zeros(6), self.time_s)
        return self.perception.perceive(frame, arm, GripperState(self.opening, False, self.time_s), self.closed)

    def settled(self) -> View:
        for _ in range(4):
            view = self.view()
            if view.is_settled:
                return view
        raise AssertionError("the view does not settle")


def clutter() -> list[Body]:
    return [
        fruit(kind=Kind.APPLE).at(0.0, 0.1),
        fruit().at(0.15, -0.1),
        fruit().at(-0.05, 0.0),
        box().at(0.05, -0.15, 0.4),
        cup().at(0.18, 0.05),
        standing_bottle().at(0.08, 0.02),
        lying_bottle().at(-0.02, 0.19, 0.2),
    ]


def test_seven_objects_become_a_scene() -> None:
    bodies = clutter()
    view = World(bodies).settled()
    assert view.scene.num_objects == view.state.num_objects == len(view.tracks) == 7
    assert np.abs(view.scene.target.position - TARGET).max() < 2e-3
    for body in bodies:
        centre = shapely.get_coordinates(body.outline.centroid)[0]
        errors = np.hypot(*(view.state.object_positions - centre).T)
        seen = view.tracks[int(np.argmin(errors))]
        assert errors.min() < 4e-3
        assert seen.kind is body.kind and seen.is_lying is body.is_lying
        outline = shapely.Polygon(seen.outline)
        assert outline.intersection(body.outline).area > 0.9 * outline.union(body.outline).area
    assert view.state.gripper_pose == pytest.approx([-0.15, -0.15, 0.0])
    assert max(len(shape.outline) for shape in view.scene.objects) <= 14
    check_start(view.scene, view.state)


def test_the_desired_object_comes_first_and_the_closest_to_the_base_is_number_zero() -> None:
    near = World(clutter()).settled()
    far = World(clutter(), DesiredObject(Kind.ORANGE, 1)).settled()
    assert near.tracks[0].kind is far.tracks[0].kind is Kind.ORANGE
    assert near.state.desired_position == pytest.approx([-0.05, 0.0], abs=2e-3)
    assert far.state.desired_position == pytest.approx([0.15, -0.1], abs=2e-3)
    ids = [track.id for track in near.tracks[1:]]
    assert ids == sorted(ids)


def test_the_scene_stays_the_same_while_objects_move() -> None:
    world = World(clutter())
    before = world.settled()
    world.bodies[2] = world.bodies[2].at(-0.05, -0.06, 0.0)
    world.bodies[3] = world.bodies[3].at(0.02, -0.17, 0.7)
    after = world.settled()
    assert after.scene is before.scene
    assert [track.id for track in after.tracks] == [track.id for track in before.tracks]
    assert after.state.desired_position == pytest.approx([-0.05, -0.06], abs=2e-3)
    turns = after.state.object_angles - before.state.object_angles
    number = next(i for i, track in enumerate(after.tracks) if track.kind is Kind.BOX)
    assert turns[number] == pytest.approx(0.3, abs=0.03)


def test_what_is_between_closed_fingers_moves_with_the_gripper_even_unseen() -> None:
    world = World([fruit(0.03).at(-0.15, -0.15)], opening=0.06, closed=True)
    before = world.settled()
    assert before.tracks[0].is_held
    world.missed = {0}
    world.arm.tool = Tool(-0.05, -0.10, 0.5)
    with pytest.raises(PerceptionError, match=r"vanished: orange 0 at"):
        world.settled()  # nothing hides it, so it should be seen
    world = World([fruit(0.03).at(-0.15, -0.15)], opening=0.06, closed=True)
    world.settled()
    world.bodies[0] = world.bodies[0].at(-0.05, -0.10)
    world.arm.tool = Tool(-0.05, -0.10, 0.5)
    after = world.settled()
    assert after.state.desired_position == pytest.approx([-0.05, -0.10], abs=2e-3)
    check_start(after.scene, after.state)


def test_a_drop_is_a_drop_for_the_rules() -> None:
    world = World([fruit().at(0.22, 0.0), cup().at(0.0, 0.0)])
    world.settled()
    world.missed = {0}
    views = [world.view() for _ in range(3)]
    assert not rules.is_dropped(views[0].scene, views[0].state) and not views[0].is_settled
    assert rules.is_dropped(views[-1].scene, views[-1].state) and views[-1].tracks[0].is_dropped


def test_flicker_changes_nothing() -> None:
    world = World(clutter())
    before = world.settled()
    ghost = detection(CAMERA, fruit(0.03).at(-0.15, 0.15))
    for missed, extra in (({3}, []), (set(), [ghost]), ({1, 5}, []), (set(), [ghost])):
        world.missed, world.extra = missed, extra
        view = world.view()
        assert view.scene == before.scene
        assert view.state.object_poses == pytest.approx(before.state.object_poses, abs=2e-3)
        assert not view.is_settled
    world.missed, world.extra = set(), []
    assert world.settled().scene == before.scene


def test_an_object_that_is_missed_for_long_is_there_as_long_as_the_image_shows_it() -> None:
    world = World(clutter())
    before = [world.view(world.painted()) for _ in range(4)][-1]
    world.missed = {0, 3}
    view = [world.view(world.painted()) for _ in range(10)][-1]
    assert view.is_settled and view.scene == before.scene
    assert view.state.object_poses == pytest.approx(before.state.object_poses, abs=2e-3)
    del world.bodies[3]
    world.missed = {0}
    world.view(world.painted())
    world.view(world.painted())
    with pytest.raises(PerceptionError, match=r"vanished: box 3"):
        world.view(world.painted())


def test_a_new_object_counts_once_it_persists() -> None:
    world = World([fruit().at(0.0, 0.0)])
    world.settled()
    world.bodies.append(cup().at(0.1, -0.1))
    assert [world.view().scene.num_objects for _ in range(3)] == [1, 1, 2]


def test_images_that_are_refused() -> None:
    world = World([fruit().at(0.0, 0.0)])
    image = world.picture()
    world.view(image)
    with pytest.raises(PerceptionError, match="frozen"):
        world.view(image)
    with pytest.raises(PerceptionError, match="black"):
        world.view(np.zeros_like(image))
    with pytest.raises(PerceptionError, match="shows nothing"):
        world.view(np.full_like(image, 90))
    with pytest.raises(PerceptionError, match=r"shape \[100, 100, 3\]"):
        world.view(image[:100, :100])
    world.time_s = 0.0
    with pytest.raises(PerceptionError, match="old images"):
        world.view()
    relaxed = World([fruit().at(0.0, 0.0)])
    frames = replace(relaxed.settings.frames, refuse_repeated=False)
    relaxed = World(relaxed.bodies, settings=replace(relaxed.settings, frames=frames))
    relaxed.view(image)
    relaxed.view(image)


def test_no_desired_object_is_an_error_that_says_what_is_seen() -> None:
    with pytest.raises(PerceptionError, match="bottle number 0, is not seen; seen are: orange 0 at"):
        World([fruit().at(0.0, 0.0)], DesiredObject(Kind.BOTTLE)).view()


def test_a_target_that_moves_is_an_error() -> None:
    world = World([fruit().at(0.0, 0.0)])
    world.settled()
    image = np.full((CAMERA.height, CAMERA.width, 3), (150.0, 140.0, 120.0))

    def bare() -> np.ndarray:
        return np.clip(image + world.rng.normal(0.0, 3.0, image.shape), 0, 255).astype(np.uint8)

    world.view(bare())
    world.view(bare())
    with pytest.raises(PerceptionError, match="camera or the surface has moved"):
        world.view(bare())


def test_the_time_of_each_part_is_told() -> None:
    parts = World([fruit().at(0.0, 0.0)]).view().latencies
    assert set(parts) == {"kinematics", "segmentation", "outlines", "target", "tracking", "state"}
    assert min(parts.values()) >= 0.0

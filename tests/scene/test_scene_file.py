"""Scene files: bit-exact round trips, the examples, and errors that name line and field."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.calls import FEW_CALLS, counted_calls
from visualrhp.errors import SceneError
from visualrhp.scene import (
    Gripper,
    ObjectShape,
    Scene,
    SceneDistribution,
    TargetRegion,
    TaskInstance,
    check_start,
    geometry,
    graspability,
    load_task_instance,
    perturb,
    sample_task_instance,
    save_task_instance,
    scene_file_schema,
)
from visualrhp.streams import Split, Stream, generator_for
from visualrhp.types import State

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "scenes"
SCENES = sorted(path for path in EXAMPLES.iterdir() if path.name != "scene.schema.json")

GOOD = """\
target:
  position: [0.1, 0.1]
start: {pose: [0, -0.2, 1.5]}
objects:
  - outline: [[0, 0], [0.04, 0], [0.04, 0.04], [0, 0.04]]
    pose: [0.0, 0.0, 0]
  - outline:
    - [0.1, 0]
    - [0.16, 0]
    - [0.16, 0.03]
    - [0.1, 0.03]
"""


def load_text(folder: Path, text: str, name: str = "scene.yaml") -> TaskInstance:
    (folder / name).write_text(text, encoding="utf-8")
    return load_task_instance(folder / name)


def error_of(folder: Path, text: str, name: str = "scene.yaml") -> str:
    with pytest.raises(SceneError) as caught:
        load_text(folder, text, name)
    return str(caught.value).replace(str(folder / name), "scene")


def assert_same(first: TaskInstance, second: TaskInstance) -> None:
    """Bit-exact, signs of zeros included."""
    assert first.scene == second.scene
    assert first.state.vector.tobytes() == second.state.vector.tobytes()
    for one, other in zip(first.scene.objects, second.scene.objects, strict=True):
        assert one.outline.tobytes() == other.outline.tobytes()


@pytest.mark.parametrize("suffix", [".yaml", ".yml", ".json"])
def test_random_instances_come_back_bit_exactly(tmp_path: Path, suffix: str) -> None:
    for index in range(4):
        instance = sample_task_instance(SceneDistribution(friction=1 / 3), 0, Split.TUNING, index)
        noisy = TaskInstance(
            perturb(instance.scene, 0.01, generator_for(0, Split.TUNING, index, Stream.NOISE)), instance.state
        )
        for number, given_instance in enumerate((instance, noisy)):
            path = tmp_path / f"{index}_{number}{suffix}"
            save_task_instance(path, given_instance)
            loaded = load_task_instance(path)
            assert_same(loaded, given_instance)
            written = path.read_bytes()
            save_task_instance(path, loaded)
            assert path.read_bytes() == written


finite = st.floats(-0.2, 0.2)


@settings(max_examples=25)
@given(
    poses=st.lists(st.tuples(finite, finite, st.floats(-3.2, 3.2)), min_size=1, max_size=2),
    density=st.floats(1e-300, 1e4),
    friction=st.floats(5e-324, 10.0),
    stroke=st.floats(1e-3, 0.1),
    radius=st.floats(1e-9, 10.0),
    closed=st.booleans(),
)
def test_any_floats_come_back_bit_exactly(
    tmp_path_factory: pytest.TempPathFactory,
    poses: list[tuple[float, float, float]],
    density: float,
    friction: float,
    stroke: float,
    radius: float,
    closed: bool,
) -> None:
    l_shape = ObjectShape.centred(
        [[0, 0], [0.05, 0], [0.05, 0.02], [0.02, 0.02], [0.02, 0.06], [0, 0.06]], density, friction
    )
    objects = (l_shape,) * len(poses)
    scene = Scene(TargetRegion([-0.0, 1e-17], radius), objects, gripper=Gripper(stroke=stroke))
    state = State.create((5.0, -0.0, 1e-5), stroke / 3.0, closed, poses)
    try:
        check_start(scene, state)
    except SceneError:
        assume(False)
    for suffix in (".yaml", ".json"):
        path = tmp_path_factory.getbasetemp() / f"any{suffix}"
        save_task_instance(path, TaskInstance(scene, state))
        assert_same(load_task_instance(path), TaskInstance(scene, state))


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.name)
def test_examples(path: Path, tmp_path: Path) -> None:
    instance = load_task_instance(path)
    check_start(instance.scene, instance.state)
    position, radius = instance.scene.target.position, instance.scene.target.radius
    assert np.hypot(*(instance.state.object_poses[0, :2] - position)) > radius, "solved from the start"
    for suffix in (".yaml", ".json"):
        save_task_instance(tmp_path / f"again{suffix}", instance)
        assert_same(load_task_instance(tmp_path / f"again{suffix}"), instance)
    text = path.read_text(encoding="utf-8")
    first = json.loads(text)["description"] if path.suffix == ".json" else text.splitlines()[0].removeprefix("# ")
    assert len(first) > 40 and first.endswith("."), "a first comment says what it shows"


def test_examples_show_what_they_say() -> None:
    by_name = {path.stem: load_task_instance(path).scene for path in SCENES}
    assert len(by_name) >= 5
    stroke = Gripper().stroke
    assert graspability(by_name["push"].objects[0], stroke) == "never"
    assert graspability(by_name["cluttered_grasp"].objects[0], stroke) == "always"
    assert [len(shape.convex_parts) for shape in by_name["l_and_u"].objects] == [2, 3]
    assert not geometry.is_convex(by_name["kidney_table"].edges)


def test_the_published_schema_is_current() -> None:
    published = json.loads((EXAMPLES / "scene.schema.json").read_text(encoding="utf-8"))
    assert published == scene_file_schema()
    assert published["required"] == ["target", "objects"]


def test_defaults(tmp_path: Path) -> None:
    instance = load_text(tmp_path, GOOD.replace("start: {pose: [0, -0.2, 1.5]}\n", ""))
    scene, state = instance.scene, instance.state
    assert scene.gripper == Gripper()
    assert scene.edges.tolist() == [[-0.25, -0.25], [0.25, -0.25], [0.25, 0.25], [-0.25, 0.25]]
    assert scene.target.radius == 0.07
    assert state.gripper_pose == pytest.approx([0.0, -0.22, np.pi / 2])
    assert (state.gripper_opening, state.gripper_closed) == (0.085, False)
    assert all((shape.density, shape.friction) == (1.0, 0.3) for shape in scene.objects)
    closed = load_text(tmp_path, GOOD.replace("1.5]}", "1.5], closed: true}")).state
    assert (closed.gripper_opening, closed.gripper_closed) == (0.0, True)


def test_a_pose_is_that_of_the_frame_in_which_the_outline_is_drawn(tmp_path: Path) -> None:
    state = load_text(tmp_path, GOOD).state
    assert state.object_poses == pytest.approx(np.array([[0.02, 0.02, 0.0], [0.13, 0.015, 0.0]]))
    turned = load_text(tmp_path, GOOD.replace("[0.0, 0.0, 0]", "[0.1, -0.1, 1.5707963267948966]"))
    assert turned.state.object_poses[0] == pytest.approx([0.08, -0.08, np.pi / 2])
    corner = geometry.to_world(turned.scene.objects[0].outline[0], turned.state.object_poses[0])
    assert corner == pytest.approx([0.1, -0.1])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("- outline:\n", "- outlin:\n", "scene:7:5: objects[1].outlin: is not a field; did you mean outline?"),
        ("[0.04, 0]", "[0.04, zero]", 'scene:5:30: objects[0].outline[1][1]: should be a valid number, not "zero"'),
        ("[0.04, 0]", "[0.04, true]", "scene:5:30: objects[0].outline[1][1]: should be a valid number, not true"),
        ("[0.04, 0]", "[0.04, '0']", 'scene:5:30: objects[0].outline[1][1]: should be a valid number, not "0"'),
        ("[0.04, 0]", "[0.04]", "scene:5:23: objects[0].outline[1]: has too few numbers; expected: vertices"),
        ("    - [0.16, 0]", "    - [0.16, .nan]", "scene:9:14: objects[1].outline[1][1]: should be a finite number"),
        (
            "    - [0.16, 0]",
            "    - [160, 0]",
            "scene:9:8: objects[1].outline[1][0]: should be less than or equal to 100",
        ),
        ("[0.0, 0.0, 0]", "[0.0, 0.0, 90]", "scene:6:22: objects[0].pose[2]: is 90; angles are in radians"),
        ("[0.0, 0.0, 0]", "[0.0, 0.0, 0, 0]", "scene:6:11: objects[0].pose: has 4 entries; expected: frame"),
        ("[0.1, 0.1]", "[0.4, 0.1]", "scene:2:13: target.position: [0.4, 0.1] is not on the surface"),
        ("  position: [0.1, 0.1]", "  radius: 0.1", "scene:2:3: target.position: is missing; expected: centre"),
        (
            "  position: [0.1, 0.1]",
            "  position: [0.1, 0.1]\n  radius: 0",
            "scene:3:11: target.radius: should be greater",
        ),
        ("target:\n", "edges: []\ntarget:\n", "scene:1:8: edges: has 0 entries"),
        ("target:\n", "edges: [[0, 0], [1, 1], [1, 0]]\ntarget:\n", "scene:1:8: edges: runs clockwise"),
        (
            "target:\n",
            "gripper: {stroke: 0.2}\ntarget:\n",
            "scene:1:19: gripper.stroke: should be less than or equal to 0.1",
        ),
        ("1.5]}", "1.5], closed: 'no'}", 'scene:3:39: start.closed: should be a valid boolean, not "no"'),
        ("1.5]}", "1.5], opening: 0.09}", "scene:3:40: start.opening: is 0.09 m; it ranges from 0 to the stroke"),
        (
            "[0.04, 0], [0.04, 0.04], [0, 0.04]",
            "[0, 0.04], [0.04, 0]",
            "scene:5:14: objects[0].outline: runs clockwise",
        ),
        ("[0.04, 0.04], [0, 0.04]", "[0, 0.04], [0.04, 0.04]", "objects[0].outline[0]: crosses or touches itself"),
        ("    - [0.16, 0]\n", 2 * "    - [0.16, 0]\n", "scene:10:7: objects[1].outline[2]: has the duplicate vertex"),
        ("    - [0.16, 0]\n", "    - [0.13, 0]\n    - [0.16, 0]\n", "scene:9:7: objects[1].outline[1]: has collinear"),
        ("0.03]", "0.002]", "scene:8:5: objects[1].outline: is too thin: 2 mm wide; at least 3 mm is needed"),
        ("[0.0, 0.0, 0]", "[0.24, 0.0, 0]", "scene:6:11: objects[0].pose: puts the centre of mass of objects[0] at"),
        ("[0.0, 0.0, 0]", "[0.09, 0.0, 0]", "objects[1].pose: objects[0] and objects[1] overlap around (0.1"),
        ("[0, -0.2, 1.5]", "[0.02, 0.05, 1.5]", "objects[0].pose: objects[0] and the palm overlap"),
        ("start:", "target: {position: [0, 0]}\nrobot:", "scene:3:1: target: occurs twice; remove one"),
        ("start:", "start", "scene:3:28: is not a YAML file"),
        ("[0.1, 0.1]", "!!python/object/apply:os.getcwd []", "scene:2:"),
        ("[0.1, 0.1]", "&a [*a, *a]", "is nested too deeply"),
        ("[0.1, 0.1]", "{? [1] : 2}", "has a key that is not the name of a field"),
        ("[0.1, 0.1]", "[" * 4000, "is not a YAML file"),
    ],
)
def test_errors_name_line_and_field(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in GOOD
    message = error_of(tmp_path, GOOD.replace(old, new, 1) if old != "0.03]" else GOOD.replace(old, new))
    assert expected in message


def test_every_fault_of_a_pass_is_reported(tmp_path: Path) -> None:
    text = GOOD.replace("[0.1, 0.1]", "[0.1]").replace("pose: [0.0", "poze: [0.0")
    assert [line.split(": ")[1] for line in error_of(tmp_path, text).splitlines()] == [
        "target.position",
        "objects[0].poze",
    ]


def test_json(tmp_path: Path) -> None:
    content = {
        "target": {"position": [0.1, 0.1]},
        "objects": [{"outline": [[0, 0], [0.04, 0], [0.04, 1e-2], [0, 1e-2]]}],
    }
    instance = load_text(tmp_path, json.dumps(content, indent="\t"), "scene.json")
    assert instance.scene.objects[0].area == pytest.approx(4e-4)
    text = json.dumps(content, indent="\t")
    assert error_of(tmp_path, text.replace("0.04", "null", 1), "scene.json").startswith(
        "scene:16:6: objects[0].outline[1][0]"
    )
    assert error_of(tmp_path, text[:-1], "scene.json").startswith("scene:")
    assert "is not JSON" in error_of(tmp_path, "target: 1", "scene.json")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"missing\.yaml: cannot be read"):
        load_task_instance(tmp_path / "missing.yaml")
    with pytest.raises(SceneError, match=r"ends with one of \.yaml"):
        load_task_instance(tmp_path / "scene.toml")
    assert "is empty" in error_of(tmp_path, "")
    assert "should be a mapping" in error_of(tmp_path, "- 1")
    (tmp_path / "scene.yaml").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(SceneError, match="UTF-8"):
        load_task_instance(tmp_path / "scene.yaml")


def test_aliases_do_not_multiply(tmp_path: Path) -> None:
    """Ten levels of nine aliases each stand for 3.5 thousand million values."""
    lines = ["a0: &a0 [1]"] + [f"a{n}: &a{n} [{', '.join(9 * [f'*a{n - 1}'])}]" for n in range(1, 11)]
    assert "a10: is not a field" in error_of(tmp_path, "\n".join(lines))


def a_shape(count: int, noise: float = 0.0, radius: float = 0.045) -> list[list[float]]:
    """Three lobes, not convex."""
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    radii = radius * (1.0 + 0.25 * np.cos(3.0 * angles)) + np.random.default_rng(0).normal(0.0, noise, count)
    return (radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)).tolist()


def with_objects(*outlines: list[list[float]]) -> str:
    """JSON, which is YAML, too."""
    return json.dumps({"target": {"position": [0.1, 0.1]}, "objects": [{"outline": outline} for outline in outlines]})


@pytest.mark.parametrize("name", ["scene.yaml", "scene.json"])
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (with_objects(a_shape(800, 1e-5)), None),
        (with_objects(a_shape(9999, 1e-5)), None),
        (with_objects(a_shape(9999, 3e-5)), None),
        (with_objects(a_shape(3000, 1e-3)), "scene:1:62: objects[0].outline: "),
        (with_objects(a_shape(20_000)), "objects[0].outline: has 20000 vertices; at most 10000 are possible"),
        (with_objects(*[[[0, 0], [0.1, 0], [0.1, 0.1]]] * 400), "objects[1].pose: objects[0] and objects[1] overlap"),
        (with_objects(*[[[0, 0], [0.1, 0], [0.1, 0.1]]] * 600), "objects: has 600 entries; at most 500 objects"),
        ("[" + "[0,1]," * 160_000 + "0]", "scene"),
        ("[" * 900_000, "scene"),
        ("{" + ", ".join(f'"k{n}": 1' for n in range(10_000)) + "}", "k9999: is not a field"),
        ('{"' + "k" * 900_000 + '": 1}', "scene"),
        (with_objects([["a", "b"]] * 9000), "objects[0].outline[0][0]: should be a valid number"),
        (with_objects([[10**400, 0], [1, 1], [2, 0]]), "objects[0].outline[0][0]: "),
        (" " * 1_100_000, "has more than 1000000 bytes"),
    ],
    ids=range(14),
)
def test_a_file_of_a_megabyte_is_read_or_refused_at_once(
    tmp_path: Path, text: str, expected: str | None, name: str
) -> None:
    with counted_calls() as calls:
        if expected is None:
            (shape,) = load_text(tmp_path, text, name).scene.objects
            assert len(shape.convex_parts) < 100 and 0.0 < shape.contact_tolerance < 3e-4
        else:
            message = error_of(tmp_path, text, name)
            assert expected in message and len(message) < 2000
    assert calls.count < FEW_CALLS, "about 1 s"


@pytest.mark.parametrize("times", [2, 400])
def test_aliases_of_large_outlines_do_not_multiply_either(tmp_path: Path, times: int) -> None:
    outline = f"&o {{outline: {json.dumps(a_shape(9000))}}}"
    text = f"target: {{position: [0.1, 0.1]}}\nobjects: [{outline}, {', '.join(times * ['*o'])}]"
    assert "vertices in all outlines; at most 20000" in error_of(tmp_path, text)


def test_what_is_no_file(tmp_path: Path) -> None:
    (tmp_path / "folder.yaml").mkdir()
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    os.mkfifo(tmp_path / "pipe.yaml")
    for name in ("folder.yaml", "loop.yaml", "pipe.yaml", "nothing\0.yaml", "x" * 5000 + ".yaml"):
        with pytest.raises(SceneError, match="it should be a scene file") as caught:
            load_task_instance(tmp_path / name)
        assert len(str(caught.value)) < 1000


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=4)
            | st.dictionaries(
                st.sampled_from(["objects", "target", "outline", "pose", "edges", "start", "gripper", "position", "a"]),
                inner,
            )
        ),
        max_leaves=15,
    )
)
def test_any_document_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, content: object) -> None:
    path = tmp_path_factory.getbasetemp() / "any_document.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        load_task_instance(path)
    assert len(str(caught.value)) < 2000


def test_what_could_not_be_loaded_again_is_not_written(tmp_path: Path) -> None:
    box = ObjectShape.centred([[0, 0], [0.04, 0], [0.04, 0.04], [0, 0.04]])
    scene = Scene(TargetRegion([0.0, 0.0]), (box, box))
    overlapping = State.create((0, -0.2, 0), 0.085, False, [(0.1, 0.1, 0), (0.11, 0.1, 0)])
    unwrapped = State.create((0, -0.2, 7.0), 0.085, False, [(0.1, 0.1, 0), (0.15, 0.1, 0)])
    for state, message in ((overlapping, "overlap"), (unwrapped, r"start.pose\[2\]: is 7.0; angles")):
        with pytest.raises(SceneError, match=message):
            save_task_instance(tmp_path / "scene.yaml", TaskInstance(scene, state))
    with pytest.raises(SceneError, match="ends with one of"):
        save_task_instance(tmp_path / "scene.txt", TaskInstance(scene, unwrapped))
    assert not list(tmp_path.iterdir())


def test_importing_the_layer_does_not_import_the_yaml_parser() -> None:
    code = "import sys, visualrhp.scene; sys.exit('ruamel.yaml' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

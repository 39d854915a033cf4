"""Hostile scene files, distributions, contours and parameters of the physics: sane ones changed, and wild ones.

What is accepted is used: shapes are decomposed, instances drawn, scenes simulated for one action. Faults: an exception
that is no VisualRHPError, a case of over 2 s, a message of over 2,000 characters, a result that is not what was asked.
"""

from __future__ import annotations

import copy
import json
import math
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely

from visualrhp.errors import VisualRHPError
from visualrhp.scene import (
    ObjectShape,
    SceneDistribution,
    check_start,
    geometry,
    load_task_instance,
    perturb,
    sample_task_instance,
    save_task_instance,
)
from visualrhp.simulation import Physics, TransitionModel, make_action_space
from visualrhp.streams import Split

SECONDS: Final = 2.0
CHARACTERS: Final = 2000
VALUES: Final[tuple[Any, ...]] = (
    *(None, True, False, 0, 1, -1, 3, 10**30, 10**400, 0.1, -0.0, 1e-9, 1e-320, 1e300, math.inf, -math.inf, math.nan),
    *("", "a", "0.1", "ü", "\0", "x" * 3000, "1e5", "~", [], {}, [1], [0.1, 0.2], [[0, 0], [1, 0], [1, 1]], {"a": 1}),
    *([[]], [[[]]], [None], ["a", "b"], [True, False], [1, 2, 3], [0.2, 0.1], [math.nan] * 2, {"outline": []}),
)
TEXTS: Final = (
    *(
        "{",
        "}",
        "[",
        "]",
        ":",
        ",",
        "- ",
        "? ",
        "&a ",
        "*a",
        "!!int ",
        "!x ",
        "|\n",
        ">\n",
        "#",
        "'",
        '"',
        "%YAML 9.9\n",
    ),
    *(
        "\t",
        "\n",
        "\r",
        "\0",
        "\x85",
        "\ufeff",
        "---\n",
        "...\n",
        "<<: ",
        "=",
        "@",
        "`",
        "\\ud800",
        "1e999",
        "0x",
        "__",
    ),
    *("[" * 2000, "- " * 2000, "{a: " * 500, "9" * 5000, "a" * 5000, "😀", "[0,1]," * 300, "k: 1\n" * 3),
)
_OUTLINES: Final = (
    [[0, 0], [0.04, 0], [0.04, 0.04], [0, 0.04]],
    [[0, 0], [0.06, 0], [0.06, 0.02], [0.02, 0.02], [0.02, 0.06], [0, 0.06]],
    [[0, 0], [0.08, 0], [0.08, 0.06], [0.06, 0.06], [0.06, 0.02], [0.02, 0.02], [0.02, 0.06], [0, 0.06]],
)
_SHOWN = 5


class WrongResult(Exception):
    """What was accepted is not what was asked for."""


def run(num_cases: int, seed: int) -> dict[str, Any]:
    """Try ``num_cases`` inputs; count what happens."""
    rng = np.random.default_rng(seed)
    counts: Counter[str] = Counter()
    examples: dict[str, list[str]] = {}
    slowest = 0.0
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        for number in range(num_cases):
            name = str(rng.choice(list(KINDS)))
            drawn = int(rng.integers(2**32))
            started = time.process_time()
            outcome, told = attempt(KINDS[name], np.random.default_rng(drawn), Path(folder))
            duration = time.process_time() - started
            slowest = max(slowest, duration)
            found = [outcome] if outcome in ("tracebacks", "surprises", "long_messages") else []
            found += ["slow"] if duration > SECONDS else []
            counts.update([f"{name}: {outcome}", *found])
            for fault in found:
                if len(shown := examples.setdefault(fault, [])) < _SHOWN:
                    shown.append(f"case {number}: KINDS[{name!r}] with seed {drawn}, {duration:.2f} s: {told[-600:]}")
    totals = {name: counts.pop(name, 0) for name in ("tracebacks", "surprises", "slow", "long_messages")}
    return {
        "cases": num_cases,
        **totals,
        "slowest_s": round(slowest, 2),
        "outcomes": dict(sorted(counts.items())),
        "examples": examples,
    }


def attempt(
    case: Callable[[np.random.Generator, Path], None], rng: np.random.Generator, folder: Path
) -> tuple[str, str]:
    """What happens in a case: accepted, refused, or a fault; and what was said."""
    try:
        case(rng, folder)
    except VisualRHPError as error:
        message = str(error)
        return ("long_messages" if len(message) > CHARACTERS or not message else "refused"), message
    except WrongResult as error:
        return "surprises", str(error)
    except Exception:
        return "tracebacks", traceback.format_exc()
    return "accepted", ""


# ---------------------------------------------------------------------------------------------------------- scene files
def document(rng: np.random.Generator) -> dict[str, Any]:
    """A scene that can be read, with random contents."""
    count = int(rng.integers(1, 5))
    places = rng.permutation(9)[:count]
    objects = [
        {
            "outline": copy.deepcopy(_OUTLINES[rng.integers(len(_OUTLINES))]),
            "pose": [0.13 * (place % 3 - 1) - 0.03, 0.11 * (place // 3 - 1) - 0.03, float(rng.uniform(-0.3, 0.3))],
            "density": float(rng.uniform(0.1, 10.0)),
            "friction": float(rng.uniform(0.1, 1.0)),
        }
        for place in places.tolist()
    ]
    return {
        "target": {"position": rng.uniform(-0.2, 0.2, 2).tolist(), "radius": 0.05},
        "start": {"pose": [0.0, -0.24, 1.57], "closed": bool(rng.integers(2))},
        "gripper": {"stroke": 0.08, "finger_thickness": 0.012},
        "edges": [[-0.25, -0.25], [0.25, -0.25], [0.25, 0.25], [-0.25, 0.25]],
        "objects": objects,
    }


def places_in(content: Any) -> list[tuple[Any, Any]]:
    """All (container, key) of a document."""
    items = list(content.items()) if isinstance(content, dict) else list(enumerate(content))
    found = [(content, key) for key, _ in items]
    for _, value in items:
        if isinstance(value, dict | list):
            found += places_in(value)
    return found


def change(content: Any, rng: np.random.Generator) -> None:
    """Change a value somewhere: another one, none, a number scaled or moved, a key renamed, an item twice."""
    places = places_in(content)
    if not places:
        return
    container, key = places[int(rng.integers(len(places)))]
    value = container.get(key) if isinstance(container, dict) else container[key]
    match int(rng.integers(7)):
        case 0 | 1:
            container[key] = copy.deepcopy(VALUES[rng.integers(len(VALUES))])
        case 2:
            del container[key]
        case 3 if isinstance(value, int | float):
            container[key] = value * float(rng.choice([0.0, -1.0, 1e-3, 0.9, 1.1, 10.0, 1000.0, 1e308]))
        case 4 if isinstance(container, dict):
            container[f"{key}{rng.choice(['s', '_', ' ', 'x' * 2000])}"] = container.pop(key)
        case 5 if isinstance(container, list):
            many = [1, 2, 600, 3000] if len(str(value)) < 60 and len(places) < 500 else [1, 2]
            container[key:key] = [copy.deepcopy(value)] * int(rng.choice(many))
        case 6 if isinstance(value, list):
            container[key] = value[::-1]
        case _ if isinstance(value, int | float):
            container[key] = value + float(rng.normal(0.0, 0.02))


def yaml_text(content: Any) -> str:
    """YAML of plain values: JSON, with the numbers of YAML that JSON has not."""
    text = json.dumps(content, default=str)
    return text.replace("NaN", ".nan").replace("-Infinity", "-.inf").replace("Infinity", ".inf")


def scene_file(rng: np.random.Generator, folder: Path) -> None:
    content: Any = document(rng)
    for _ in range(int(rng.integers(4))):
        change(content, rng)
    suffix = str(rng.choice([".json", ".yaml"]))
    text = json.dumps(content, indent=int(rng.integers(3))) if suffix == ".json" else yaml_text(content)
    for _ in range(int(rng.choice([0, 0, 0, 1, 3]))):
        text = changed_text(text, rng)
    path = folder / f"scene{suffix}"
    path.write_bytes(text.encode("utf-8", "surrogatepass") if rng.random() < 0.97 else rng.bytes(len(text)))
    use_scene_file(path)


def changed_text(text: str, rng: np.random.Generator) -> str:
    """A text with something put in, left out, or repeated."""
    start, end = sorted(rng.integers(0, len(text) + 1, 2).tolist())
    match int(rng.integers(4)):
        case 0:
            return text[:start] + TEXTS[rng.integers(len(TEXTS))] + text[start:]
        case 1:
            return text[:start] + text[min(end, start + 5) :]
        case 2:
            return (
                text[:start]
                if rng.random() < 0.3
                else text[:start] + chr(int(rng.integers(1, 300))) + text[start + 1 :]
            )
        case _:
            return (text[:end] + text[start:])[:1_100_000]


def use_scene_file(path: Path) -> None:
    """Load a scene, write it, load it again, and simulate an action."""
    instance = load_task_instance(path)
    check_start(instance.scene, instance.state)
    copied = path.with_name(f"copy{path.suffix}")
    try:
        save_task_instance(copied, instance)
    except VisualRHPError:
        pass
    else:
        again = load_task_instance(copied)
        if again.scene != instance.scene or again.state != instance.state:
            raise WrongResult("a scene that was written and read again is another one")
    if instance.scene.num_objects > 30:
        return
    model = TransitionModel(instance.scene, make_action_space("continuous"))
    next_state = model.simulate(instance.state, np.array([0.8, 0.2, 0.3, 1.0])).next_state
    if not np.isfinite(next_state.vector).all():
        raise WrongResult("a pose is not finite")


# -------------------------------------------------------------------------------------------------------- distributions
def distribution(rng: np.random.Generator, _: Path) -> None:
    low, high = sorted(rng.integers(1, 21, 2).tolist())
    given: dict[str, Any] = {
        "num_objects": (low, high) if rng.random() < 0.3 else int(rng.integers(1, 9)),
        "object_size": str(rng.choice(["small", "mixed", "large"])),
        "surface_side": float(rng.choice([0.5, 0.5, 0.3, 0.1, 0.8, 3.0, 100.0])),
        "target_radius": float(rng.choice([0.07, 0.02, 0.2, 0.4, 0.6, 2.0])),
        "clearance": float(rng.choice([0.005, 0.0, 0.01, 0.05, 0.1, 0.2, 0.3])),
        "num_vertices": tuple(sorted(rng.integers(3, 13, 2).tolist())),
        "start_distance": tuple(sorted(rng.uniform(-0.02, 0.1, 2).tolist())),
        "layout": str(rng.choice(["uniform", "uniform", "target_at_edge", "object_in_corner", "object_behind"])),
    }
    for name in rng.permutation(list(given))[: int(rng.integers(len(given)))].tolist():
        del given[name]
    if rng.random() < 0.5 and given:
        names = [*given, "friction", "density", "start_angle", "clearence"]
        given[names[rng.integers(len(names))]] = VALUES[rng.integers(len(VALUES))]
    if rng.random() < 0.2:
        given = {name: value[::-1] if isinstance(value, tuple) else value for name, value in given.items()}
    instance = sample_task_instance(SceneDistribution(**given), int(rng.integers(1000)), Split.TUNING, 0)
    check_start(instance.scene, instance.state)


# ------------------------------------------------------------------------------------------------------------- contours
def points(rng: np.random.Generator) -> np.ndarray:
    """[N, 2] a closed curve: lobes, noise, pixels, spikes, crossings."""
    count = int(rng.choice([3, 4, 6, 12, 40, 150, 400, 900, 3000]))
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    lobes, depth = int(rng.integers(0, 9)), float(rng.choice([0.0, 0.1, 0.5, 0.9, 1.5]))
    radii = 0.04 * (1.0 + depth * np.cos(lobes * angles)) + rng.normal(
        0.0, float(rng.choice([0, 1e-9, 1e-5, 2e-4, 5e-3])), count
    )
    curve = radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    match int(rng.integers(8)):
        case 0:
            curve = np.round(curve / 5e-4) * 5e-4
        case 1:
            curve = rng.permutation(curve) if count < 50 else np.repeat(curve, 2, axis=0)
        case 2:
            curve[rng.integers(count)] *= float(rng.choice([0.0, 5.0, 1e5, np.nan, np.inf]))
        case 3:
            curve = curve * float(rng.choice([1e-6, 1e-2, 30.0, 1000.0, 1e200])) + float(rng.choice([0.0, 0.3, 99.0]))
        case 4:
            curve = curve[::-1]
        case 5:
            curve = curve * (1.0, float(rng.choice([0.0, 1e-3, 0.1])))
        case 6:
            teeth = np.arange(count) % 2 * float(rng.choice([1e-3, 4e-3, 0.03]))
            curve = curve * (1.0 + teeth / 0.04)[:, None]
    return curve


def given_as(curve: np.ndarray, rng: np.random.Generator) -> Any:
    """A curve as somebody may have it."""
    match int(rng.integers(9)):
        case 0:
            return curve[:, None]
        case 1:
            return curve.tolist()
        case 2:
            return shapely.Polygon(curve) if len(curve) > 3 and np.isfinite(curve).all() else curve
        case 3:
            return VALUES[rng.integers(len(VALUES))]
        case 4:
            return [curve]
        case 5:
            return curve.astype(str) if rng.random() < 0.5 else curve.astype(complex)
        case 6:
            return curve.astype(np.float32)
    return curve


def contour(rng: np.random.Generator, _: Path) -> None:
    curve = points(rng)
    given, tolerance = given_as(curve, rng), float(rng.choice([1e-3, 1e-4, 2e-4, 1e-6, 5e-3]))
    tolerance = VALUES[rng.integers(len(VALUES))] if rng.random() < 0.05 else tolerance
    shape = ObjectShape.from_contour(given, tolerance)
    use_shape(shape, rng)
    plain = shapely.Polygon(curve) if np.isfinite(curve).all() and len(curve) > 2 else None
    if plain is not None and plain.is_valid and not isinstance(given, str | dict):
        outline = geometry.simplify_contour(curve, tolerance)
        border = shapely.LinearRing(outline)
        if shapely.distance(border, shapely.points(curve)).max() > 1.001 * tolerance:
            raise WrongResult(f"an outline deviates by more than its tolerance, {tolerance} m")


def outline(rng: np.random.Generator, _: Path) -> None:
    use_shape(
        ObjectShape.centred(
            given_as(points(rng), rng), *([VALUES[rng.integers(len(VALUES))]] if rng.random() < 0.1 else [])
        ),
        rng,
    )


def use_shape(shape: ObjectShape, rng: np.random.Generator) -> None:
    """Decompose a shape, and perturb it now and then."""
    parts = shape.convex_parts
    if not all(geometry.is_convex(part) for part in parts):
        raise WrongResult("a part is not convex")
    # Without a grid, GEOS loses pieces of a union of hundreds of polygons now and then.
    union = shapely.union_all([shapely.Polygon(part) for part in parts], grid_size=1e-10)
    difference = union.symmetric_difference(shapely.Polygon(shape.outline)).area
    allowed = 1e-8 + 1.1 * shape.contact_tolerance * shapely.Polygon(shape.outline).length
    if difference > allowed:
        raise WrongResult(f"the parts of a shape differ from it by {difference} m^2, more than {allowed}")
    if rng.random() < 0.1:
        from visualrhp.scene import Scene, TargetRegion

        perturb(Scene(TargetRegion(np.zeros(2)), (shape,)), 0.03, rng)


# -------------------------------------------------------------------------------------------------------------- physics
def physics(rng: np.random.Generator, _: Path) -> None:
    given: dict[str, Any] = {}
    for name in rng.permutation(list(Physics.__dataclass_fields__))[: int(rng.integers(1, 4))].tolist():
        default: Any = getattr(Physics(), name)
        factor = float(rng.choice([0.0, 0.1, 0.5, 0.9, 1.1, 2.0, 10.0]))
        scaled = type(default)(default * factor) if factor < 5.0 or not isinstance(default, int) else default * 3
        given[name] = VALUES[rng.integers(len(VALUES))] if rng.random() < 0.4 else scaled
    parameters = Physics(**given)
    if parameters.motion_steps + parameters.settle_steps > 3000 or parameters.iterations > 100:
        return
    instance = sample_task_instance(SceneDistribution(num_objects=3), int(rng.integers(50)), Split.TUNING, 0)
    model = TransitionModel(instance.scene, make_action_space("continuous"), parameters)
    model.simulate(instance.state, rng.uniform(-1.0, 1.0, 4))


KINDS: Final = {
    "scene file": scene_file,
    "distribution": distribution,
    "contour": contour,
    "outline": outline,
    "physics": physics,
}

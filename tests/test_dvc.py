"""``dvc.yaml`` lists what a result depends on: the code that computes it, found through its imports."""

from __future__ import annotations

import ast
import itertools
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
STAGES: dict[str, Any] = yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]

NOT_PART_OF_A_RESULT = {
    "pipelines/__init__.py": "has no code",
    "pipelines/config/__init__.py": "has no code",
    "pipelines/config/common.py": "a schema; the values are in conf/, and a changed range changes no result",
    "pipelines/config/execution.py": "a schema",
    "pipelines/config/groups.py": "a schema",
    "pipelines/config/stages.py": "a schema",
    "pipelines/workflow": "starts, tracks and stores the work; tests show that results do not depend on it",
    "visualrhp/__init__.py": "registers the Gymnasium environment",
    "visualrhp/documents.py": "checks documents",
    "visualrhp/errors.py": "messages",
    "visualrhp/files.py": "writes files whole or not at all",
    "visualrhp/parameters.py": "checks parameters",
}
"""Files and folders whose imports are not followed either."""

PICTURES = {
    "visualrhp/rendering": "pictures and videos",
    "pipelines/previews.py": "videos",
    "visualrhp/evaluation/films.py": "videos",
    "visualrhp/evaluation/styles.py": "colours of figures",
    "visualrhp/evaluation/axes.py": "figures",
    "visualrhp/evaluation/training_figures.py": "figures",
    "visualrhp/demonstrations/pictures.py": "pictures and videos",
}
"""Code that shows a result. Only the report depends on it; other stages apply a change with their next result."""

NOT_IMPORTED = {
    "pipelines/planners.py": [
        "visualrhp.planning.closed_loop_krrt",
        "visualrhp.planning.dhrrt",
    ],  # by the configuration
    "visualrhp/environments/backends.py": ["visualrhp.environments.worker"],  # started as a process
    "visualrhp/observation/observation.py": ["visualrhp.observation"],  # registered by the package
}
"""Further code that a file makes use of."""

OTHER_LEARNER = {
    "continuous": {"visualrhp/learning/dqn.py": "the learner of the discrete action space"},
    "discrete": {"visualrhp/learning/c3po.py": "the learner of the continuous action space"},
}


def file_of(module: str) -> Path | None:
    """The file of a module of this project."""
    path = ROOT / Path(*module.split("."))
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if candidate.is_file() and module.split(".")[0] in ("visualrhp", "pipelines"):
            return candidate
    return None


@lru_cache
def imports(path: Path) -> tuple[tuple[str, str | None], ...]:
    """(module, imported name or None) of all imports in a file that are executed, within functions, too."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = {
        id(child)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for child in ast.walk(node)
    }
    found: list[tuple[str, str | None]] = []
    for node in ast.walk(tree):
        if id(node) in for_types:
            continue
        if isinstance(node, ast.Import):
            found += [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [(str(node.module), alias.name) for alias in node.names]
    return tuple(found)


def definitions(module: str, name: str | None) -> Iterator[Path]:
    """The file in which what is imported is defined: through what a package exports, to the module behind it."""
    if name is not None and file_of(f"{module}.{name}"):
        yield from definitions(f"{module}.{name}", None)
        return
    path = file_of(module)
    if path is None:
        return
    if path.name == "__init__.py" and name is not None:
        for source, exported in imports(path):
            if exported == name:
                yield from definitions(source, name)
                return
    yield path


def is_within(path: Path, entries: Any) -> bool:
    relative = path.relative_to(ROOT)
    return any(relative == Path(entry) or Path(entry) in relative.parents for entry in entries)


def code_behind(pipeline: str, left_out: dict[str, str]) -> set[Path]:
    """All files of the project that the result of a pipeline depends on."""
    waiting, found = [ROOT / "pipelines" / f"{pipeline}.py"], set()
    while waiting:
        path = waiting.pop()
        if path in found or is_within(path, left_out):
            continue
        found.add(path)
        further = [(module, None) for module in NOT_IMPORTED.get(str(path.relative_to(ROOT)), [])]
        waiting += itertools.chain.from_iterable(definitions(*imported) for imported in (*imports(path), *further))
    return found


def expanded(name: str) -> Iterator[tuple[str, dict[str, str], list[str]]]:
    """(stage, item, dependencies on code) of a stage, once for each item of ``foreach`` or ``matrix``."""
    stage = STAGES[name]
    if "matrix" in stage:
        keys = list(stage["matrix"])
        items = [dict(zip(keys, values, strict=True)) for values in itertools.product(*stage["matrix"].values())]
    else:
        each = stage.get("foreach", [{}])
        items = list(each.values()) if isinstance(each, dict) else [e if isinstance(e, dict) else {"": e} for e in each]
    for item in items:
        text = yaml.safe_dump(stage.get("do", stage)["deps"])
        for key, value in item.items():
            text = text.replace("${item%s}" % (f".{key}" if key else ""), str(value))
        yield name, item, [entry for entry in yaml.safe_load(text) if entry.startswith(("visualrhp", "pipelines"))]


def cases() -> list[Any]:
    return [
        pytest.param(*case, id="-".join([case[0], *map(str, case[1].values())]))
        for name in STAGES
        for case in expanded(name)
    ]


@pytest.mark.parametrize(("stage", "item", "listed"), cases())
def test_a_stage_depends_on_the_code_that_computes_its_result(
    stage: str, item: dict[str, str], listed: list[str]
) -> None:
    left_out = dict(NOT_PART_OF_A_RESULT)
    if stage != "report":
        left_out |= PICTURES
    if stage == "train_rl":
        left_out |= OTHER_LEARNER[item["action_space"]]
    code = code_behind(stage, left_out)
    assert all((ROOT / entry).exists() for entry in listed)
    missing = sorted(str(path.relative_to(ROOT)) for path in code if not is_within(path, listed))
    assert not missing, f"dvc.yaml: {stage} should depend on {missing}"
    needless = [entry for entry in listed if not any(is_within(path, [entry]) for path in code)]
    assert not needless, f"dvc.yaml: the result of {stage} does not depend on {needless}"


def test_stages_depend_on_configuration_that_exists() -> None:
    for stage in STAGES.values():
        for entry in stage.get("do", stage)["deps"]:
            pattern = re.sub(r"\$\{[\w.]+\}", "*", entry)
            assert pattern.startswith("outputs/") or list(ROOT.glob(pattern)), f"dvc.yaml: {entry} does not exist"


def test_only_evaluation_and_report_depend_on_every_planner() -> None:
    depending = [name for name, stage in STAGES.items() if "conf/planner" in stage.get("do", stage)["deps"]]
    assert depending == ["evaluate", "report"]
    assert "conf/planner/kinodynamic_rrt.yaml" in STAGES["generate_demos"]["do"]["deps"]


def test_what_is_left_out_exists() -> None:
    exceptions = [NOT_PART_OF_A_RESULT, PICTURES, *OTHER_LEARNER.values()]
    for entry in itertools.chain(*exceptions):
        assert (ROOT / entry).exists(), entry


def test_data_files_of_the_library_are_dependencies_of_the_report() -> None:
    """Templates, for instance, are not found through imports."""
    (_, _, listed), *_ = expanded("report")
    files = [path for package in ("visualrhp", "pipelines") for path in (ROOT / package).rglob("*") if path.is_file()]
    of_the_robot = (ROOT / "visualrhp/embodiment", ROOT / "visualrhp/pretrained/segmenter")  # not reported
    files = [path for path in files if not any(path.is_relative_to(folder) for folder in of_the_robot)]
    data = [path for path in files if path.suffix not in (".py", ".pyc")]
    assert data and all(is_within(path, listed) for path in data)


def test_evaluation_computes_its_numbers_without_the_code_of_reports() -> None:
    """A former defect: a change of a figure left stale metrics next to a new report."""
    code = {str(path.relative_to(ROOT)) for path in code_behind("evaluate", NOT_PART_OF_A_RESULT | PICTURES)}
    assert not [path for path in code if re.search(r"figure|report|page|rendering", path)]

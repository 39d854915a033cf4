"""The tests mirror the code, and test what is public."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TESTS = sorted((ROOT / "tests").rglob("*.py"))

TESTED_ELSEWHERE = {
    "pipelines/evaluate_execution.py": "tests/pipelines/test_execute.py",
    "pipelines/evaluate_segmenter.py": "tests/pipelines/test_segmenter.py",
    "pipelines/filming.py": "tests/pipelines/test_report.py",
    "pipelines/generate_frames.py": "tests/pipelines/test_segmenter.py",
    "pipelines/networks.py": "tests/planning/test_configured_planners.py",
    "pipelines/planners.py": "tests/planning/test_configured_planners.py",
    "pipelines/previews.py": "tests/pipelines/test_train_il.py",
    "pipelines/robot_episode.py": "tests/pipelines/test_execute.py",
    "pipelines/robots.py": "tests/pipelines/test_execute.py",
    "pipelines/train_segmenter.py": "tests/pipelines/test_segmenter.py",
    "pipelines/training.py": "tests/pipelines/test_train_il.py",
    "pipelines/config": "tests/pipelines/test_config.py",
    "visualrhp/embodiment/segmentation/export.py": "tests/embodiment/segmentation/test_onnx_segmenter.py",
}
"""Glue whose behaviour is that of what uses it."""


def modules() -> Iterator[Path]:
    for package in ("visualrhp", "pipelines"):
        for path in sorted((ROOT / package).rglob("*.py")):
            relative = path.relative_to(ROOT)
            if path.name != "__init__.py" and not any(
                relative == Path(entry) or Path(entry) in relative.parents for entry in TESTED_ELSEWHERE
            ):
                yield relative


@pytest.mark.parametrize("module", list(modules()), ids=str)
def test_every_module_has_its_tests(module: Path) -> None:
    folder = module.parent.relative_to("visualrhp") if module.parts[0] == "visualrhp" else module.parent
    mirror = ROOT / "tests" / folder / f"test_{module.name}"
    assert mirror.is_file(), f"{module} should be tested by {mirror.relative_to(ROOT)}"


def test_modules_tested_elsewhere_are_listed_once() -> None:
    for module, test in TESTED_ELSEWHERE.items():
        assert (ROOT / module).exists() and (ROOT / test).is_file()


def privates(path: Path) -> Iterator[str]:
    """Private names of others that a test uses: ``object._name``, ``setattr(object, "_name", ...)``."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute):
            owner = node.value.id if isinstance(node.value, ast.Name) else ""
            is_own = owner in ("self", "cls") or node.attr.startswith("__")
            if node.attr.startswith("_") and not is_own and node.attr != "_target_":  # Hydra's
                yield f"line {node.lineno}: {ast.unparse(node)}"
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in ("visualrhp", "pipelines"):
            yield from (f"line {node.lineno}: {a.name}" for a in node.names if a.name.startswith("_"))
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("setattr"):
            for argument in node.args[:2]:
                value = argument.value if isinstance(argument, ast.Constant) else None
                name = value.rpartition(".")[2] if isinstance(value, str) else ""
                if name.startswith("_") and not name.startswith("__"):
                    yield f"line {node.lineno}: {value}"


@pytest.mark.parametrize("path", TESTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_tests_reach_into_no_privates(path: Path) -> None:
    assert not list(privates(path))


@pytest.mark.parametrize("package", ["visualrhp", "pipelines", "tests"])
def test_no_file_is_longer_than_400_lines(package: str) -> None:
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in (ROOT / package).rglob("*.py")}
    assert not {str(path): length for path, length in lengths.items() if length > 400}

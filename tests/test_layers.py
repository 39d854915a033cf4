"""Imports go down the list of layers, and the library knows nothing of the pipelines' tools."""

from __future__ import annotations

import ast
import itertools
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "visualrhp"

# A layer may import those above it in this list (and itself); those that share a line may import each other.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("types", "errors", "files", "streams", "parameters", "documents"),
    ("scene",),
    ("simulation",),
    ("observation",),
    ("rendering",),
    ("heuristics",),
    ("pretrained",),
    ("planning",),
    ("execution",),
    ("environments",),
    ("demonstrations",),
    ("learning",),
    ("evaluation",),
    ("embodiment",),
)
RANKS = {name: rank for rank, names in enumerate(LAYERS) for name in names}
TOOLS_OF_THE_PIPELINES = ("hydra", "omegaconf", "mlflow", "dvc", "joblib", "tqdm", "pipelines")

MODULES = sorted(PACKAGE.rglob("*.py"))


def imported_modules(path: Path) -> Iterator[tuple[int, str]]:
    """(line, full module name) of every import in a file, within functions and type-checking blocks, too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno} imports relatively"
            yield node.lineno, f"{node.module}"
            for alias in node.names:  # from visualrhp import scene
                yield node.lineno, f"{node.module}.{alias.name}"


def layer_of(module: str) -> str | None:
    parts = module.split(".")
    return parts[1] if parts[0] == "visualrhp" and len(parts) > 1 and parts[1] in RANKS else None


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_go_down(path: Path) -> None:
    own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    for line, module in imported_modules(path):
        assert module.split(".")[0] not in TOOLS_OF_THE_PIPELINES, f"{path}:{line} imports {module}"
        layer = layer_of(module)
        if layer is not None and own in RANKS:
            assert RANKS[layer] <= RANKS[own], f"{path}:{line}: {own} must not import {module}"


def test_every_module_belongs_to_a_layer() -> None:
    names = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in MODULES}
    assert names - {"__init__"} <= set(RANKS)


def test_the_library_prints_nothing() -> None:
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            called = node.func if isinstance(node, ast.Call) else None
            assert not (isinstance(called, ast.Name) and called.id == "print"), f"{path} prints"


def test_only_what_is_declared_is_imported() -> None:
    """Every top-level import of the library and the pipelines is a dependency in pyproject.toml."""
    import tomllib

    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {name: needs for name, needs in project["optional-dependencies"].items() if name != "test"}
    requirements = [*project["dependencies"], *itertools.chain(*extras.values())]
    declared = {re.split(r"[\[>]", requirement)[0].lower().replace("-", "_") for requirement in requirements}
    of_module = {
        "PIL": "pillow",
        "cv2": "opencv_python_headless",
        "hydra": "hydra_core",
        "ruamel": "ruamel.yaml",
        "yaml": "pyyaml",
    }
    for path in [*MODULES, *(PACKAGE.parent / "pipelines").rglob("*.py")]:
        for line, module in imported_modules(path):
            top = module.split(".")[0]
            if top in sys.stdlib_module_names or top in ("visualrhp", "pipelines"):
                continue
            assert of_module.get(top, top).lower() in declared, f"{path}:{line}: {top} is not declared"

"""Hostile arguments of the command line, by a grammar: every pipeline is composed and validated in this process.

What is valid is not run. Faults: an exception that the command line would report as a bug, a message of over 2,000
characters, and more than 2 s.
"""

from __future__ import annotations

import dataclasses
import os
import random
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import hydra

import pipelines.config
from pipelines.config import PipelineConfig
from pipelines.workflow import app
from visualrhp.errors import VisualRHPError

SCHEMAS: Final = {
    "generate_demos": "GenerateDemosConfig",
    "train_il": "TrainILConfig",
    "train_rl": "TrainRLConfig",
    "expert_iteration": "ExpertIterationConfig",
    "evaluate": "EvaluateConfig",
    "report": "ReportConfig",
    "play": "PlayConfig",
    "tune_crafted": "TuneCraftedConfig",
    "verify_demos": "VerifyDemosConfig",
    "export_demos": "ExportDemosConfig",
}
VALUES: Final = (
    *("0", "1", "-1", "1e400", "nan", "inf", "-0.0", "1e-320", "9" * 40, "0x10", "1_000", "1.5", "true", "null", ""),
    *("[]", "{}", "[1]", "[1,2]", "[2,1]", "[1,2,3]", "[[1,7]]", "{a:1}", "[null]", "[a", "{a", "a]", "???", "none"),
    *("a", "a b", "'a b'", '"a', "ü", '"ü"', "~/a", "a=b", "a&b", "a#b", "a%b", "a?b", "${seed}", "${nothing}", "${"),
    *("../..", "/", ".", "~", "a/b", "$HOME", "*", "glob(*)", "range(3)", "choice(1,2)", "int(x)", "1,2", "\\", "\t"),
    *("x" * 300, "[" * 60, "{a:" * 40, "cpu", "cuda", "image", "cartesian", "continuous", "discrete", "greedy"),
)
_SECONDS = 2.0
_CHARACTERS = 2000


def run(num_cases: int, seed: int) -> dict[str, Any]:
    """Compose ``num_cases`` command lines; count what happens."""
    rng = random.Random(seed)
    counts: Counter[str] = Counter()
    faults: list[str] = []
    slowest = 0.0
    with _hydra():
        for _ in range(num_cases):
            pipeline = rng.choice(list(SCHEMAS))
            overrides = [override(rng, keys_of(pipeline)) for _ in range(rng.randint(1, 3))]
            begun = time.process_time()
            outcome = outcome_of(pipeline, overrides)
            seconds = time.process_time() - begun
            slowest = max(slowest, seconds)
            counts[outcome.partition(":")[0]] += 1
            if outcome.startswith("bug"):
                faults.append(f"{pipeline} {overrides}: {outcome}"[:500])
            if seconds > _SECONDS:
                faults.append(f"{pipeline} {overrides}: {seconds:.1f} s"[:500])
    return {"cases": num_cases, **counts, "slowest_s": round(slowest, 2), "faults": faults[:20]}


def override(rng: random.Random, keys: list[str]) -> str:
    """An argument: mostly ``key=value`` with a key that exists."""
    key = rng.choice(keys)
    shape = rng.random()
    if shape < 0.1:
        key = mutated(rng, key)
    value = rng.choice(VALUES)
    if rng.random() < 0.15:
        value = mutated(rng, value)
    if shape > 0.97:
        return rng.choice([key, f"={value}", value, f"{key}:{value}", f"{key}==", f"@{key}={value}", "-x", "--"])
    prefix = rng.choices(["", "+", "++", "~"], [90, 4, 3, 3])[0]
    return f"{prefix}{key}={value}"


def mutated(rng: random.Random, text: str) -> str:
    """``text`` with a character added, replaced or removed."""
    position = rng.randrange(len(text) + 1)
    character = rng.choice("abz019.,=~&@/\\'\"[]{}()$ ü\n\x00")
    return text[:position] + rng.choice([character, ""]) + text[position + rng.randint(0, 1) :]


def outcome_of(pipeline: str, overrides: list[str]) -> str:
    """``valid``, ``refused``, or ``bug: ...``."""
    schema: type[PipelineConfig] = getattr(pipelines.config, SCHEMAS[pipeline])
    try:
        app.compose(pipeline, schema, overrides)
    except VisualRHPError as error:
        text = str(error)
        return "refused" if len(text) < _CHARACTERS else f"bug: a message of {len(text)} characters: {text[:100]}"
    except Exception as error:
        mistake = app.mistake_of(error)
        return "refused" if mistake is not None else f"bug: {type(error).__name__}: {error}"
    return "valid"


@lru_cache
def keys_of(pipeline: str) -> list[str]:
    """All keys and groups of a pipeline."""
    schema: type[PipelineConfig] = getattr(pipelines.config, SCHEMAS[pipeline])
    config = app.compose(pipeline, schema)
    groups = [entry.name for entry in app.CONFIG_FOLDER.iterdir() if entry.is_dir()]
    return [*_keys(dataclasses.asdict(config)), *groups, "experiment", "hydra.run.dir", "hydra.job.name"]


def _keys(content: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for name, value in content.items():
        yield prefix + name
        if isinstance(value, dict) and name != "scale":
            yield from _keys(value, f"{prefix}{name}.")


@contextmanager
def _hydra() -> Iterator[None]:
    """Hydra, started once; in an empty folder, where no case finds a file."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            with hydra.initialize_config_dir(version_base="1.3", config_dir=str(app.CONFIG_FOLDER)):
                yield
        finally:
            os.chdir(before)

"""The benchmarks still run: not how fast anything is."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tests.benchmarks", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_cheap_sections_print_their_rows() -> None:
    answer = _run("--quick", "simulation", "environment")
    assert answer.returncode == 0, answer.stderr
    for num_objects in ("1 object", "4 objects", "7 objects"):
        for row in ("advance, {}", "set state and get state, {}", "label image, {}", "step, {}, discrete, cartesian"):
            found = re.search(f"^{row.format(num_objects)}.* of (the bare Chipmunk loop|filling)", answer.stdout, re.M)
            assert found, (row, num_objects)
    assert answer.stdout.count("peak memory of") == 2


def test_networks_are_compared_with_what_is_installed() -> None:
    answer = _run("--quick", "inference")
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.count("of PyTorch, eager") == 18
    assert ("of ONNX Runtime" in answer.stdout) != ("ONNX Runtime is not installed" in answer.stdout)


def test_training_is_compared_with_plain_pytorch_and_stable_baselines3() -> None:
    answer = _run("--quick", "training")
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.count("of plain PyTorch") == 2
    assert answer.stdout.count("of Stable-Baselines3") == 2


def test_paths_of_the_arm_are_compared_with_pink() -> None:
    answer = _run("--quick", "kinematics")
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.count("of Pink, a step a sample") == 3
    assert "allows, one motion" in answer.stdout


def test_steps_of_an_environment_are_counted() -> None:
    """Those of ours, by the file that steps the peers' environments too."""
    wanted = {"module": "visualrhp", "id": "visualrhp/ClutterManipulation-v0", "arguments": {}, "draws": False}
    answer = subprocess.run(
        [sys.executable, ROOT / "tests" / "benchmarks" / "steps.py", json.dumps(wanted)],
        cwd=ROOT,
        input="0.01\n0.01\n",
        capture_output=True,
        text=True,
        check=True,
    )
    facts, *rounds = map(json.loads, answer.stdout.splitlines())
    assert facts == {"observation": [64, 64], "dtype": "uint8"}
    assert len(rounds) == 2
    assert all(r["steps"] >= 1 and r["step_time"] >= 0.01 and r["memory"] > 0.0 for r in rounds)


def test_unknown_section() -> None:
    answer = _run("speed")
    assert answer.returncode == 2
    assert "unknown section speed" in answer.stderr


def test_the_robot_cell_is_measured() -> None:
    answer = _run("--quick", "cell")
    assert answer.returncode == 0, answer.stderr
    rows = ("step of 2 ms, 7 objects", "action, 4 objects", "frame, 1 object", "new cell, 7 objects")
    for row in (*rows, "Executed paths: 32 random actions", "at the end: at most 0.0"):
        assert row in answer.stdout


def test_perception_is_measured() -> None:
    answer = _run("--quick", "perception")
    assert answer.returncode == 0, answer.stderr
    for row in ("segmentation, 7 objects", "all but segmentation, 4 objects"):
        assert row in answer.stdout

"""``segmenter/dvc.yaml`` lists what the results of its stages depend on, as ``dvc.yaml`` does for the others."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from tests.test_dvc import NOT_PART_OF_A_RESULT, PICTURES, ROOT, code_behind, is_within

PIPELINE: dict[str, Any] = yaml.safe_load((ROOT / "segmenter" / "dvc.yaml").read_text(encoding="utf-8"))
STAGES: dict[str, Any] = PIPELINE["stages"]

SCHEMAS = {"pipelines/config/segmenter.py": "a schema", "pipelines/config/execution.py": "a schema"}


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_depends_on_the_code_that_computes_its_result(stage: str) -> None:
    listed = [entry for entry in STAGES[stage]["deps"] if entry.startswith(("visualrhp", "pipelines"))]
    code = code_behind(stage, NOT_PART_OF_A_RESULT | PICTURES | SCHEMAS)
    missing = sorted(str(path.relative_to(ROOT)) for path in code if not is_within(path, listed))
    assert not missing, f"segmenter/dvc.yaml: {stage} should depend on {missing}"
    needless = [entry for entry in listed if not any(is_within(path, [entry]) for path in code)]
    assert not needless, f"segmenter/dvc.yaml: the result of {stage} does not depend on {needless}"


def test_stages_depend_on_files_that_exist_or_are_made() -> None:
    made = {out for stage in STAGES.values() for out in stage["outs"]}
    for name, stage in STAGES.items():
        assert stage["wdir"] == ".." and f"python -m pipelines.{name} " in stage["cmd"]
        for entry in stage["deps"]:
            assert entry in made or (ROOT / entry).exists(), f"segmenter/dvc.yaml: {entry} does not exist"


def test_the_other_pipeline_does_not_run_these_stages() -> None:
    main = yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
    assert not set(main) & set(STAGES)

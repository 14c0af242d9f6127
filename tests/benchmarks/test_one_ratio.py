"""One of Delivery's ratios from nothing, in the profile that learns nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import one_ratio


def test_a_further_ratio_takes_what_was_learned(tmp_path: Path) -> None:
    path = tmp_path / "ratio.json"
    one_ratio.main(["--profile", "smoke", "--seed", "3", "--json", str(path)])
    found = json.loads(path.read_text())
    assert found["seed"] == 3
    stages = [one["stage"] for one in found["from_nothing"]["stage_seconds"]]
    assert sorted(stages) == sorted(
        ["TrainedExpert"] * 2 + ["LearnedNorm"] * 2 + ["PrimaryReturn", "Covered", "Asked"]
    )
    assert [one["stage"] for one in found["further"]["stage_seconds"]] == ["Asked"]
    for name in ("from_nothing", "further"):
        assert found[name]["wall_seconds"] > 0
        assert set(found[name]["objectives"]) == {"delivered", "helped", "cleaned", "vases_broken"}


@pytest.mark.parametrize(("name", "value", "least"), [("jobs", "0", 1), ("seed", "-1", 0)])
def test_numbers_that_make_no_sense_are_refused(
    name: str, value: str, least: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as refused:
        one_ratio.main([f"--{name}", value])
    assert refused.value.code == 2
    assert f"{name} is {value}; it must be at least {least}" in capsys.readouterr().err

"""The Python in the README runs, and the commands that it shows exist."""

import re
from pathlib import Path

import pytest

from moral_algorithms.cli import COMMANDS

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("block", re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL))
def test_python_blocks_run(block: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(block, {})  # noqa: S102 - the project's own README
    assert capsys.readouterr().out


def test_commands_exist() -> None:
    shown = set(re.findall(r"^moral (\w+)", README, flags=re.MULTILINE))
    assert shown
    assert shown <= set(COMMANDS)
    targets = set(re.findall(r"^make (\w+)", README, flags=re.MULTILINE))
    makefile = (Path(__file__).parents[1] / "Makefile").read_text(encoding="utf-8")
    assert targets
    assert all(f"\n{target}:" in makefile for target in targets)


def test_links_inside_the_repository_lead_somewhere() -> None:
    prose = re.sub(r"```.*?```", "", README, flags=re.DOTALL)
    links = re.findall(r"\]\(((?!http)[^)#]+)\)", prose)
    assert links
    missing = [link for link in links if not (Path(__file__).parents[1] / link).exists()]
    assert not missing

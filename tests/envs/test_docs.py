"""The Python on the pages of the site runs, and shows what happens."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import pytest

import moral_envs
from tests import pages

NEED_TORCH = {"ecosystem/stable-baselines3.md", "library.md", "live.md"}
"""Pages that tests/algorithms runs, for here there is no PyTorch."""


@pytest.mark.parametrize("page", [*sorted(set(pages.pages_with_python()) - NEED_TORCH), "../envs/README.md"])
def test_a_page_shows_what_happens(page: str) -> None:
    pages.run_page(page)


def test_a_new_world_takes_less_than_40_lines() -> None:
    world, *_ = pages.read_blocks("new-world.md")
    assert "return World(" in world.code
    assert "gymnasium.register(" in world.code
    assert len(world.code.splitlines()) < 40


@pytest.mark.parametrize(
    ("page", "error"),
    [
        ("```python\n1 + 1  # 3\n```\n", "page.md:2 shows ' 3', not '2'"),
        ("A line.\n\n```python\nx = 1  # one\n\nprint(x)\n```\n", "page.md:4 prints\n1"),
        ("```python\nprint(1)\n```\n\n```text\n2\n```\n", "page.md:2 prints\n1"),
        ("```python\nx = 1\n```\n\n```python\nprint(x)  # 2\n```\n", "page.md:6 shows ' 2', not '1\\n'"),
        ("- ```python\n  x = 1\n  ```\n", "page.md has a Python block that is not read"),
    ],
)
def test_a_page_that_shows_something_else_fails(
    page: str, error: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "DOCS", tmp_path)
    (tmp_path / "page.md").write_text(page)
    with pytest.raises(AssertionError) as caught:
        pages.run_page("page.md")
    assert error in str(caught.value)


def test_every_world_has_a_page_with_its_docstring() -> None:
    index = (pages.DOCS / "index.md").read_text(encoding="utf-8")
    worlds = [module for module in moral_envs.__all__ if module.endswith("_v0")]
    for module in worlds:
        page = f"worlds/{module.removesuffix('_v0')}"
        assert f"<!-- docstring of moral_envs.{module} -->" in (pages.DOCS / f"{page}.md").read_text()
        assert f"]({page}.md)" in index
    ids = [env_id for env_id in gymnasium.registry if env_id.startswith("moral/")]
    assert len(ids) == len(worlds)
    assert all(f"`{env_id}`" in index for env_id in ids)

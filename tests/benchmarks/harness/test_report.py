"""The page: every benchmark with its verdict, well-formed whatever the texts hold."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from PIL import Image

from benchmarks.harness import Benchmark, Check, Results, Store
from benchmarks.harness.benchmark import verdict
from benchmarks.harness.report import write_report
from tests.benchmarks.harness.runs import Square, Written, benchmark

VOID = {"meta", "img", "br", "link"}
AWKWARD = 'below <b> & "above" | a\nline'


class Page(HTMLParser):
    """Reads a page, in which every element must be closed where it was opened."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.pictures: list[str] = []
        self.text: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        values = dict(attrs)
        assert len(values) == len(attrs)
        self.ids += [values["id"] or ""] if "id" in values else []
        self.links += [values["href"] or ""] if tag == "a" else []
        self.pictures += [values["src"] or ""] if tag == "img" else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def made(tmp_path: Path, *benchmarks: Benchmark) -> tuple[Page, str]:
    page = write_report(benchmarks, Store(tmp_path), "smoke")
    assert page == tmp_path / "report" / "index.html"
    markdown = (tmp_path / "report" / "report.md").read_text(encoding="utf-8")
    return Page(page.read_text(encoding="utf-8")), markdown


def check(met: bool) -> Check:
    return Check("statement", "1", met, "thesis")


@pytest.mark.parametrize(
    ("met", "expected"),
    [([True, True], "holds"), ([True, False], "differs"), ([False], "fails"), ([], "not run")],
)
def test_verdicts(met: list[bool], expected: str) -> None:
    assert verdict([check(one) for one in met]) == expected


def test_a_page_with_and_without_results(tmp_path: Path) -> None:
    store = Store(tmp_path)
    runs = [Square(3), Square(4)]
    for run in runs:
        store.perform(run, "0123456789abcdef0123-dirty")
    page, markdown = made(tmp_path, benchmark(runs), benchmark([Written(7)], id="X2", title="Nothing yet"))
    assert page.ids == ["X1", "X2"]
    assert page.links == ["#X1", "#X2"]
    assert page.pictures == ["X1.png"]
    with Image.open(tmp_path / "report" / "X1.png") as picture:
        assert picture.size == (220, 110)
        darkest, lightest = picture.convert("L").getextrema()
        assert darkest < lightest
    text = " ".join("".join(page.text).split())
    assert "Profile smoke: 1 hold, 0 differ, 0 fail, 1 not run." in text
    assert "2 of 2 runs" in text
    assert "commit 0123456789ab-dirty." in text
    assert "0 of 1 runs" in text
    assert "python -m benchmarks run X2 --profile smoke" in text
    assert "## X1. Squares: holds\n" in markdown
    assert "| ours | one is above ten | 16 | yes |" in markdown
    assert "![Squares](X1.png)" in markdown
    assert "## X2. Nothing yet: not run\n" in markdown


def test_a_verdict_of_some_of_the_runs_says_so(tmp_path: Path) -> None:
    Store(tmp_path).perform(Square(4), None)
    page, markdown = made(tmp_path, benchmark([Square(4), Square(5)]))
    assert "holds so far" in page.text
    assert "X1. Squares: holds so far\n" in markdown
    assert "1 of 2 runs" in markdown
    assert "commit" not in markdown


def test_texts_are_escaped(tmp_path: Path) -> None:
    def judge(results: Results) -> list[Check]:
        return [Check(AWKWARD, AWKWARD, False, "thesis")]

    Store(tmp_path).perform(Square(3), None)
    changes = dict.fromkeys(("title", "source", "claim", "bar"), AWKWARD)
    page, markdown = made(tmp_path, benchmark([Square(3)], judge=judge, **changes))
    assert page.text.count(AWKWARD) >= 4
    assert "b" not in page.open
    rows = [line for line in markdown.splitlines() if line.startswith("| ")]
    assert len({re.sub(r"\\\|", "", line).count("|") for line in rows[:2]}) == 1
    assert r'| thesis | below <b> & "above" \| a line | below <b> & "above" \| a line | **no** |' in rows


def test_the_same_records_give_the_same_page(tmp_path: Path) -> None:
    Store(tmp_path).perform(Square(3), None)
    listed = benchmark([Square(3)])
    made(tmp_path, listed)
    before = {path.name: path.read_bytes() for path in (tmp_path / "report").iterdir()}
    made(tmp_path, listed)
    assert {path.name: path.read_bytes() for path in (tmp_path / "report").iterdir()} == before
    assert before.keys() == {"X1.png", "index.html", "report.md"}

"""The Python on the pages of the site, as tests: it runs, and what a page shows is what happens.

The blocks of a page run from top to bottom in one namespace. In a block

- a comment at the end of a line that is an expression is the expression's value, or what it prints;
- a ``text`` block that follows is all else that the block prints; without one it prints nothing else.

White space is compared as one blank.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1] / "docs"

_OPENING = "```python\n"
_BLOCK = re.compile(
    rf"^{_OPENING}(?P<code>.*?)^```$(?:\n\n```text\n(?P<shown>.*?)^```$)?", flags=re.MULTILINE | re.DOTALL
)


@dataclass(frozen=True)
class Block:
    """A Python block of a page."""

    page: str
    line: int
    code: str
    shown: str


def pages_with_python() -> list[str]:
    pages = (page for page in sorted(DOCS.rglob("*.md")) if _OPENING in page.read_text(encoding="utf-8"))
    return [page.relative_to(DOCS).as_posix() for page in pages]


def read_blocks(page: str) -> list[Block]:
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks = [
        Block(page, text.count("\n", 0, found.start("code")) + 1, found["code"], found["shown"] or "")
        for found in _BLOCK.finditer(text)
    ]
    assert len(blocks) == text.count(_OPENING), f"{page} has a Python block that is not read"
    return blocks


def run_page(page: str) -> None:
    """Run a page's blocks; raises an AssertionError that says where it shows something else."""
    namespace: dict[str, Any] = {"__name__": page}
    for block in read_blocks(page):
        printed = _run(block, namespace)
        assert _one_line(printed) == _one_line(block.shown), f"{page}:{block.line} prints\n{printed}"


def _run(block: Block, namespace: dict[str, Any]) -> str:
    """Run a block, check the values in its comments, and return what else it prints."""
    printed = ""
    comments = _comments_after_code(block.code)
    for statement in ast.parse(block.code).body:
        assert statement.end_lineno is not None
        comment = comments.get(statement.end_lineno)
        ast.increment_lineno(statement, block.line - 1)
        out, where = io.StringIO(), f"{block.page}:{statement.end_lineno}"
        with redirect_stdout(out):
            if not isinstance(statement, ast.Expr):
                exec(compile(ast.Module([statement], []), block.page, "exec"), namespace)  # noqa: S102 - our own
                comment = None
            else:
                value = eval(compile(ast.Expression(statement.value), block.page, "eval"), namespace)  # noqa: S307
        if comment is None:
            printed += out.getvalue()
        else:
            found = out.getvalue() or repr(value)
            assert _one_line(comment) == _one_line(found), f"{where} shows {comment!r}, not {found!r}"
    return printed


def _comments_after_code(code: str) -> dict[int, str]:
    """Return the comments, by line, that have code before them on their line."""
    tokens = tokenize.generate_tokens(io.StringIO(code).readline)
    comments = (token for token in tokens if token.type == tokenize.COMMENT)
    return {token.start[0]: token.string[1:] for token in comments if token.line[: token.start[1]].strip()}


def _one_line(text: str) -> str:
    return " ".join(text.split())

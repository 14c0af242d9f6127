"""The command: what it prints, how it ends, and that what is wrong with it takes one line."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks import command, rows
from benchmarks.command import main
from benchmarks.harness import Run, Store
from tests.benchmarks.harness.runs import Failing, Square, Total, Written, benchmark
from tests.closed_output import run_into_closed_pipe

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def listed(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Run]]:
    """Runs of the benchmark X1, to which a test adds; X2 has one that is finished at once."""
    runs: list[Run] = []
    found = {}
    for name, benchmarks in (("x1", benchmark(runs)), ("x2", benchmark([Square(1)], id="X2", title="One"))):
        found[f"{rows.__name__}.{name}"] = module = ModuleType(name)
        module.BENCHMARK = benchmarks  # type: ignore[attr-defined]
    monkeypatch.setattr(rows, "ORDER", ("x1", "x2"))
    importing = command.importlib.import_module
    monkeypatch.setattr(command.importlib, "import_module", lambda name: found.get(name) or importing(name))
    return runs


def refusal(capsys: Capture, *options: str | Path) -> str:
    assert main([str(option) for option in options]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("benchmarks: error: ")
    assert err.count("\n") == 1
    return err.removeprefix("benchmarks: error: ").rstrip()


def test_from_nothing_to_the_report(listed: list[Run], tmp_path: Path, capsys: Capture) -> None:
    listed += [Square(3), Total((Written(2), Square(3)))]
    options = ["X1", "--profile", "smoke", "--out", str(tmp_path / "out")]
    assert main(["list", *options]) == 0
    assert capsys.readouterr().out == "X1        0 of 3    Squares (figure 0)\n"
    assert not (tmp_path / "out").exists()
    assert main(["run", *options, "--jobs", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"0 of 3 runs are finished in {tmp_path / 'out'}"
    assert [line[:11] for line in lines[1:-2]] == ["1 of 3 runs", "2 of 3 runs", "3 of 3 runs"]
    assert lines[-2:] == ["X1 Squares: fails", "  NO  one is above ten: 9"]
    assert main(["run", *options]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"3 of 3 runs are finished in {tmp_path / 'out'}",
        *lines[-2:],
    ]
    assert main(["report", "--profile", "smoke", "--out", str(tmp_path / "out")]) == 0
    page = Path(capsys.readouterr().out.strip())
    assert "Squares" in page.read_text()
    assert "One" in page.read_text()


def test_failures_are_told_and_the_rest_is_done(listed: list[Run], tmp_path: Path, capsys: Capture) -> None:
    listed += [Total((Failing(2),)), Square(4)]
    assert main(["run", "X1", "--profile", "smoke", "--out", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert "X1 Squares: holds" in out
    assert err.splitlines() == [
        f"failed: {Failing(2).key}: RuntimeError: it was not to be",
        f"failed: {Total((Failing(2),)).key}: it needs {Failing(2).key}, which failed",
        f"2 of 3 runs failed; see {tmp_path / 'logs'}",
    ]
    assert "Traceback" in (tmp_path / "logs" / f"{Failing(2).key}.txt").read_text()


def test_ctrl_c_ends_with_130(
    listed: list[Run], tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(sweep: object, executor: object) -> None:
        raise KeyboardInterrupt

    listed += [Square(3)]
    monkeypatch.setattr(command, "_carry_out", interrupted)
    assert main(["run", "X1", "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err == "\nbenchmarks: stopped; the same command goes on from here\n"


def test_ctrl_c_while_it_is_imported_takes_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    class Interrupted:
        @staticmethod
        def find_spec(name: str, path: object = None, target: object = None) -> None:
            if name == command.__name__:
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, command.__name__)
    monkeypatch.setattr(sys, "meta_path", [Interrupted, *sys.meta_path])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("benchmarks", run_name="__main__")
    assert ended.value.code == 130
    assert capsys.readouterr().err == "\nbenchmarks: stopped\n"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["run", "X9"], "ID is 'X9'; it must be all or one of X1, X2"),
        (["report", "X9"], "ID is 'X9'; it must be all or one of X1, X2"),
        (["run", "--jobs", "0"], "jobs is 0; it must be at least 1"),
        (["run", "--jobs", "two"], "argument --jobs: invalid int value: 'two'"),
        (["run", "--profile", "huge"], "argument --profile: invalid choice: 'huge'"),
        (["run", "--load", "no_such_module"], "load is 'no_such_module'; there is no such module here"),
        ([], "the following arguments are required: COMMAND"),
    ],
)
def test_what_is_wrong_takes_one_line(
    options: list[str], message: str, listed: list[Run], tmp_path: Path, capsys: Capture
) -> None:
    where = ["--out", str(tmp_path / "out")] if options else []
    assert refusal(capsys, *options, *where).startswith(message)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_none_takes_one_line(listed: list[Run], tmp_path: Path, capsys: Capture) -> None:
    listed += [Square(3)]
    (tmp_path / "out").touch()
    message = refusal(capsys, "run", "X1", "--out", tmp_path / "out")
    assert message == f"cannot write to {tmp_path / 'out'}: Not a directory"
    message = refusal(capsys, "report", "X1", "--out", tmp_path / "out")
    assert message.endswith("Not a directory")


def test_a_damaged_record_takes_one_line(listed: list[Run], tmp_path: Path, capsys: Capture) -> None:
    listed += [Square(3)]
    store = Store(tmp_path)
    store.perform(Square(3), None)
    store.record_path(Square(3)).write_text("[]")
    for name in ("list", "run", "report"):
        assert f"{Square(3).key}.json is damaged" in refusal(capsys, name, "X1", "--out", tmp_path)


def test_an_error_of_a_benchmark_itself_is_not_hidden(listed: list[Run], tmp_path: Path) -> None:
    def judge(results: object) -> list[object]:
        raise ValueError("two columns are one too many")

    Store(tmp_path).perform(Square(3), None)
    listed += [Square(3)]
    module = command.importlib.import_module(f"{rows.__name__}.x1")
    module.BENCHMARK = benchmark(listed, judge=judge)
    with pytest.raises(ValueError, match="one too many"):
        main(["run", "X1", "--out", str(tmp_path)])


def test_modules_of_the_current_folder_are_loaded(
    listed: list[Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    (tmp_path / "a_learner_of_mine.py").write_text("print('loaded')\n")
    (tmp_path / "a_learner_in_need.py").write_text("import nothing_of_the_kind\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", ["/nowhere", *__import__("sys").path])
    assert main(["list", "X2", "--load", "a_learner_of_mine", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.startswith("loaded\nX2")
    with pytest.raises(ModuleNotFoundError, match="nothing_of_the_kind"):
        main(["list", "X2", "--load", "a_learner_in_need", "--out", str(tmp_path)])


def test_a_reader_that_has_gone_is_no_error() -> None:
    command = [sys.executable, "-m", "benchmarks", "list", "--profile", "smoke"]
    assert run_into_closed_pipe(command, unbuffered=False) == (1, "")

"""The command ``python -m benchmarks``: run benchmarks, list them, write the report."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks import rows
from benchmarks.harness import Benchmark, Store
from benchmarks.harness.benchmark import PROFILES, Profile, verdict
from benchmarks.harness.errors import UsageError
from benchmarks.harness.executors import Executor, LocalProcesses, Outcome, RayCluster
from benchmarks.harness.report import judge, write_report
from benchmarks.harness.sweep import Sweep, tell
from moral_algorithms.cli.console import end_with_reader
from moral_algorithms.storage import StorageError

RESULTS = Path(__file__).parent / "results"


def main(options: Sequence[str] | None = None) -> int:
    """Carry out a command line.

    Returns
    -------
    int
        The exit status: 0; 1 if a run has failed, or the reader of the output has gone, as ``head`` does; 2
        if the command cannot be carried out, for which one line on stderr gives the reason; 130 after Ctrl-C.
    """
    return end_with_reader(lambda: _carry_out_command(options))


def _carry_out_command(options: Sequence[str] | None) -> int:
    try:
        arguments = _parser().parse_args(options)
        _load(arguments.load)
        status: int = arguments.command(arguments)
    except (UsageError, StorageError) as error:
        print(f"benchmarks: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nbenchmarks: stopped; the same command goes on from here", file=sys.stderr)
        return 130
    return status


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are like any other's."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(message)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="python -m benchmarks", description=(__doc__ or "").strip())
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    listing = commands.add_parser("list", help="name the benchmarks and how far their runs are")
    running = commands.add_parser("run", help="do the runs that are not finished, and judge")
    reporting = commands.add_parser("report", help="write the page: each figure beside its claim and verdict")
    for command, does in ((listing, _list), (running, _run), (reporting, _report)):
        command.set_defaults(command=does)
        command.add_argument(
            "ids", nargs="*", default=["all"], metavar="ID", help="E1, D6 ... or all (default)"
        )
        command.add_argument("--profile", choices=PROFILES, default="laptop", help="size (default: laptop)")
        command.add_argument(
            "--out", type=Path, help="folder of records and report (default: results/PROFILE)"
        )
        command.add_argument(
            "--load", nargs="*", default=[], metavar="MODULE", help="modules that add learners of your own"
        )
    running.add_argument(
        "--jobs", type=int, help="runs at a time, each on one core (default: 1; with --ray, all processors)"
    )
    running.add_argument(
        "--ray",
        metavar="ADDRESS",
        help="carry the runs out on a cluster of Ray: HOST:PORT, ray://HOST:PORT or local",
    )
    return parser


def find_benchmarks(ids: Sequence[str]) -> list[Benchmark]:
    """Find benchmarks by their ids, in the order of the list of figures; ``all`` finds all.

    Raises
    ------
    UsageError
        If there is none of an id.
    """
    modules = (importlib.import_module(f"{rows.__name__}.{name}") for name in rows.ORDER)
    known: dict[str, Benchmark] = {module.BENCHMARK.id: module.BENCHMARK for module in modules}
    unknown = [one for one in ids if one not in known and one != "all"]
    if unknown:
        raise UsageError(f"ID is {unknown[0]!r}; it must be all or one of {', '.join(known)}")
    return [benchmark for name, benchmark in known.items() if "all" in ids or name in ids]


def _load(modules: Sequence[str]) -> None:
    """Import modules, those in the current folder among them."""
    here = str(Path.cwd())
    if modules and here not in sys.path:
        sys.path.insert(0, here)
    for name in modules:
        if not all(part.isidentifier() for part in name.split(".")):
            raise UsageError(f"load is {name!r}; it must be the name of a module, such as my_learner")
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            if error.name != name:
                raise
            raise UsageError(f"load is {name!r}; there is no such module here or installed") from error


def _store(arguments: argparse.Namespace) -> Store:
    return Store(arguments.out or RESULTS / arguments.profile)


def _list(arguments: argparse.Namespace) -> int:
    profile: Profile = arguments.profile
    store = _store(arguments)
    for benchmark in find_benchmarks(arguments.ids):
        sweep = Sweep(store, benchmark.runs(profile))
        print(f"{benchmark.id:6}{sweep.done:>5} of {sweep.total:<5}{benchmark.title} ({benchmark.source})")
    return 0


def _run(arguments: argparse.Namespace) -> int:
    profile: Profile = arguments.profile
    if arguments.jobs is not None and arguments.jobs < 1:
        raise UsageError(f"jobs is {arguments.jobs}; it must be at least 1")
    benchmarks = find_benchmarks(arguments.ids)
    store = _store(arguments)
    store.require_writable()
    sweep = Sweep(store, [run for benchmark in benchmarks for run in benchmark.runs(profile)])
    print(f"{sweep.done} of {sweep.total} runs are finished in {store.folder}", flush=True)
    if sweep.todo:
        _carry_out(sweep, _executor(store, arguments))
    for benchmark in benchmarks:
        _, checks = judge(benchmark, store, profile)
        print(f"{benchmark.id} {benchmark.title}: {verdict(checks)}")
        for check in checks:
            print(f"  {'yes' if check.met else 'NO':4}{check.statement}: {check.value}")
    if sweep.failed:
        print(
            f"{len(sweep.failed)} of {sweep.total} runs failed; see {store.folder / 'logs'}", file=sys.stderr
        )
    return 1 if sweep.failed else 0


def _executor(store: Store, arguments: argparse.Namespace) -> Executor:
    if arguments.ray is None:
        return LocalProcesses(store, arguments.jobs or 1)
    return RayCluster(store, arguments.ray, arguments.jobs, arguments.load)


def _carry_out(sweep: Sweep, executor: Executor) -> None:
    """Do the runs of a sweep, with a bar on a terminal and a line for each run elsewhere."""
    console = Console()
    seen = sweep.done

    def line(sweep: Sweep) -> str:
        left = sweep.seconds_left(executor.jobs)
        failed = f", {len(sweep.failed)} failed" if sweep.failed else ""
        about = "" if left is None else f", about {tell(left)} left"
        return f"{sweep.done} of {sweep.total} runs, {len(sweep.running)} running{failed}{about}"

    def print_changes(sweep: Sweep) -> None:
        nonlocal seen
        if sweep.done != seen:
            seen = sweep.done
            print(line(sweep), flush=True)

    def failure(outcome: Outcome) -> str:
        return f"failed: {outcome.run.key}: {(outcome.error or '').splitlines()[-1]}"

    if not console.is_terminal:
        sweep.carry_out(executor, print_changes, lambda outcome: print(failure(outcome), file=sys.stderr))
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("", total=sweep.total)
        sweep.carry_out(
            executor,
            lambda sweep: progress.update(task, completed=sweep.done, description=line(sweep)),
            lambda outcome: console.print(failure(outcome), markup=False, highlight=False, soft_wrap=True),
        )


def _report(arguments: argparse.Namespace) -> int:
    page = write_report(find_benchmarks(arguments.ids), _store(arguments), arguments.profile)
    print(page)
    return 0

"""The report: every figure beside its claim and a verdict, from records alone."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, get_args

from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.backends.backend_agg import FigureCanvasAgg

from benchmarks.harness.benchmark import Benchmark, Check, Profile, Results, Verdict, verdict
from benchmarks.harness.run import with_needs
from benchmarks.harness.store import Store
from benchmarks.harness.sweep import tell
from moral_algorithms.storage import atomic_write

_DPI = 110


class Section(NamedTuple):
    """What the report says of one benchmark."""

    benchmark: Benchmark
    verdict: Verdict
    """Of the runs that are finished."""
    checks: list[Check]
    done: int
    """Finished runs, those counted that they need."""
    total: int
    """All runs of this profile."""
    picture: str | None
    """File name of the figure."""
    duration: str
    """What the runs took together."""
    commits: list[str]
    """Commits they were done at."""

    @property
    def provisional(self) -> bool:
        """Whether the verdict is of a part of the runs."""
        return 0 < self.done < self.total


def judge(benchmark: Benchmark, store: Store, profile: Profile) -> tuple[Results, list[Check]]:
    """Find the finished runs of a benchmark, and what its checks say of them; nothing, without any."""
    records = ((run, store.record(run)) for run in benchmark.runs(profile))
    results = Results([(run, record["result"]) for run, record in records if record is not None])
    return results, benchmark.judge(results) if len(results) else []


def write_report(benchmarks: Sequence[Benchmark], store: Store, profile: Profile) -> Path:
    """Write ``report/index.html``, ``report/report.md`` and the figures into the store's folder.

    Parameters
    ----------
    benchmarks
        What it is about, in this order.
    store
        Where the records are.
    profile
        Whose runs.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    StorageError
        If a record is damaged, or something cannot be written.
    """
    folder = store.folder / "report"
    sections = [_section(benchmark, store, profile, folder) for benchmark in benchmarks]
    environment = Environment(
        loader=PackageLoader("benchmarks.harness"),
        autoescape=lambda name: name is not None and name.endswith(".html"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["cell"] = _cell
    values: dict[str, Any] = {
        "sections": sections,
        "profile": profile,
        "counts": {name: sum(one.verdict == name for one in sections) for name in get_args(Verdict)},
        "machines": _machines(benchmarks, store, profile),
    }
    for template, name in (("report.html", "index.html"), ("report.md", "report.md")):
        text = environment.get_template(template).render(values)
        with atomic_write(folder / name) as file:
            file.write(text.encode())
    return folder / "index.html"


def _cell(text: object) -> str:
    """Write a text into a cell of a Markdown table."""
    return " ".join(str(text).split()).replace("|", "\\|")


def _section(benchmark: Benchmark, store: Store, profile: Profile, folder: Path) -> Section:
    results, checks = judge(benchmark, store, profile)
    records = [store.record(run) for run in with_needs(benchmark.runs(profile))]
    finished = [record for record in records if record is not None]
    picture = None
    if len(results):
        figure = benchmark.draw(results)
        FigureCanvasAgg(figure)
        content = BytesIO()
        figure.savefig(content, format="png", dpi=_DPI, metadata={"Software": None})
        picture = f"{benchmark.id}.png"
        with atomic_write(folder / picture) as file:
            file.write(content.getvalue())
    return Section(
        benchmark,
        verdict(checks),
        checks,
        len(finished),
        len(records),
        picture,
        tell(sum(record["duration_seconds"] for record in finished)),
        sorted({_short(record["commit"]) for record in finished if record["commit"]}),
    )


def _short(commit: str) -> str:
    """Shorten a commit's name, and keep the mark of a changed working tree."""
    name, dash, mark = commit.partition("-")
    return f"{name[:12]}{dash}{mark}"


def _machines(benchmarks: Sequence[Benchmark], store: Store, profile: Profile) -> list[str]:
    """Describe where the runs were done and with which versions."""
    found = set()
    for benchmark in benchmarks:
        for run in with_needs(benchmark.runs(profile)):
            record = store.record(run)
            if record is not None:
                versions = ", ".join(f"{name} {number}" for name, number in record["versions"].items())
                found.add(f"{record['processor']}; {record['platform']}; {versions}")
    return sorted(found)

"""``moral replay``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain, zip_longest
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from moral_algorithms import pipeline
from moral_algorithms.answers import Answer, read_answers
from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.consistency import Agreement, Consistency, measure_consistency
from moral_algorithms.learners.inference import make_posterior
from moral_algorithms.learners.recorded import vector_returns
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError, write_json


@dataclass(frozen=True)
class Command(BaseCommand):
    """Measure how consistent recorded answers are, and train again from them alone.

    World, rewards and settings are those of the run. The answers of several people combine: every pair of
    episodes is played again under the run's reward vector, so that the files may come from different runs in
    the same world. They are used in turn, one of each file after the other. Nobody is asked anything.
    """

    run: Path
    """Run directory of `moral live` or `moral train`."""
    answers: tuple[Path, ...] = ()
    """Files queries.jsonl, one for each person; without them the run's own."""
    out: Path | None = None
    """Run directory of the training from these answers; without it nothing is trained."""
    report: Path | None = None
    """JSON file for the report on consistency."""
    seed: int = 0
    """Seed of everything random."""
    machine: Annotated[Machine, arg(name="")] = field(default_factory=Machine)
    tensorboard: bool = True
    """Write TensorBoard's event files into the run directory."""

    @property
    def hint(self) -> str:
        """How to go on after an interruption."""
        if self.out is None or not RunDirectory(self.out).config.exists():
            return "start again"
        if RunDirectory(self.out).summary.exists():
            return f"the run is finished; the agent is in {self.out}"
        return pipeline.how_to_resume(RunDirectory(self.out), "train")

    def execute(self, console: Console) -> None:
        """Do it."""
        device = self.machine.prepare()
        source = RunDirectory(self.run)
        if not source.config.exists():
            raise StorageError(f"{self.run} is no run directory: it has no {source.config.name}")
        files = self.answers or (source.queries,)
        for path in files:
            if not path.exists():
                raise StorageError(f"there is no file {path}")
        people = [list(read_answers(path).standing.values()) for path in files]
        measured = self._measure(source, files, people)
        _show(console, measured)
        if self.report is not None:
            write_json(self.report, [one.to_json() for one in measured])
        if self.out is None:
            return
        directory = RunDirectory(self.out)
        setting = pipeline.Setting(device, self.machine.threads, self.tensorboard, console.stage)
        in_turn = chain.from_iterable(zip_longest(*people))
        used = [answer for answer in in_turn if answer is not None and answer.preference is not None]
        run = pipeline.begin_replay(directory, source, used, setting, self.seed)
        summary = pipeline.moral(directory, run, setting, resume=True)
        console.aligned(self.out, summary, "answers")

    def _measure(
        self, source: RunDirectory, files: Sequence[Path], people: Sequence[list[Answer]]
    ) -> list[Consistency]:
        run = pipeline.read_moral_run(source)
        components = pipeline.reward_components(source, run, "cpu")
        world = run.world.build()
        found = []
        for path, answers in zip(files, people, strict=True):
            replays = [episode for answer in answers for episode in answer.asked.episodes]
            try:
                returns = vector_returns(world, components, replays)
            except ValueError as error:
                raise StorageError(f"{path} does not fit {self.run}: {error}") from error
            who = ", ".join(sorted({answer.who for answer in answers})) or str(path)
            found.append((who, answers, returns.reshape(-1, 2, len(components))))
        return measure_consistency(
            found, lambda: make_posterior(run.config, len(components), np.random.default_rng(self.seed))
        )


def _show(console: Console, measured: Sequence[Consistency]) -> None:
    rows = [
        (
            one.who,
            f"{one.answers}",
            f"{one.cannot_tell}",
            "" if one.median_seconds is None else f"{one.median_seconds:.1f}",
            _share(one.repeated),
            _share(one.predicted),
            _share(one.others),
            one.suspicion or "",
        )
        for one in measured
    ]
    head = ("who", "answers", "unsure", "seconds", "repeats", "own", "others", "suspect")
    console.table("Consistency: repeats answered alike, answers predicted by own and by others'", head, rows)


def _share(agreement: Agreement) -> str:
    if agreement.share is None:
        return ""
    return f"{round(agreement.share * agreement.count)}/{agreement.count}"

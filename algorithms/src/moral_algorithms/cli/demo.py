"""``moral demo``."""

from __future__ import annotations

import os
import platform
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import torch
from tyro.conf import arg

from moral_algorithms import pipeline
from moral_algorithms.cli.arguments import BaseCommand, Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.learners.airl import AIRLConfig
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.moral import MoralConfig
from moral_algorithms.networks.files import load_policy
from moral_algorithms.pipeline import MoralRun
from moral_algorithms.pipeline.stage import require_kind, require_positive
from moral_algorithms.plotting import THESIS, plot_front
from moral_algorithms.run_directory import RunDirectory, commit, read_lines, versions
from moral_algorithms.storage import StorageError, write_json
from moral_algorithms.worlds import WorldSpec

# Everything that a demo leaves, by folder; the next one removes it.
_MADE = {
    "expert": ("config.json", "policy.safetensors", "summary.json", "run.lock"),
    "airl": (
        *("config.json", "metrics.jsonl", "policy.safetensors", "reward.safetensors", "summary.json"),
        "run.lock",
    ),
    "moral": (
        *("config.json", "learned_1.safetensors", "normalisers.json", "queries.jsonl", "metrics.jsonl"),
        *("checkpoint.safetensors", "policy.safetensors", "summary.json", "run.lock"),
    ),
    ".": ("config.json", "demonstrations.npz", "summary.json", "front.png"),
}


def _two_threads() -> Machine:
    """Two threads, for whoever waits for a demo trains nothing else; one where there is one core."""
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    return Machine(threads=min(2, cores))


@dataclass(frozen=True)
class Command(BaseCommand):
    """From nothing to an aligned agent in Emergency.

    An expert learns to save people and is recorded. AIRL learns from the record what people saved are worth.
    MORAL trains an agent under that reward and the extinguisher's, balanced by a simulated teacher's answers
    to 25 queries: more people saved is better and, on a tie, more goal time. The agent is measured beside the
    thesis's figures and the exact optimum.

    The folder then holds summary.json, front.png and a run directory for each stage. A later demo into the
    same folder replaces them.
    """

    out: Path = Path("runs/demo")
    """Folder."""
    seed: int = 0
    """Seed of everything random."""
    machine: Annotated[Machine, arg(name="")] = field(default_factory=_two_threads)
    tensorboard: bool = False
    """Write TensorBoard's event files into the stages' run directories."""
    demonstrations: int = 1000
    """Episodes of the expert that AIRL learns from."""
    episodes: int = 1000
    """Starts on which the agent is measured."""
    expert: ExpertConfig = field(default_factory=ExpertConfig)
    """How the expert is trained."""
    airl: AIRLConfig = field(default_factory=lambda: AIRLConfig(steps=300_000))
    """How AIRL trains; not as long as `moral airl`, for somebody waits."""
    normaliser: ExpertConfig = field(default_factory=pipeline.normaliser_config)
    """How the policy is trained that pursues the extinguisher alone: its return normalises that reward."""
    moral: MoralConfig = field(default_factory=lambda: MoralConfig(steps=500_000))
    """How MORAL trains and asks; not as long as `moral train`, at the price of half a goal step or so."""

    @property
    def hint(self) -> str:
        """How to go on after an interruption."""
        return f"what {self.out} holds is not finished; start again, and it is replaced"

    def execute(self, console: Console) -> None:
        """Do it."""
        device = self.machine.prepare()
        require_positive("demonstrations", self.demonstrations)
        require_positive("episodes", self.episodes)
        pipeline.spawn_seeds(self.seed, 1)
        directory = RunDirectory(self.out)
        _require_demo(directory)
        with directory.hold():
            _clear(directory)
            directory.write_config({"kind": "demo", **self._config()})
            setting = pipeline.Setting(device, self.machine.threads, self.tensorboard, console.stage)
            summary = self._run(directory, setting, console)
        _show(console, self.out, summary)

    def _config(self) -> dict[str, Any]:
        return {
            "seed": self.seed,
            "demonstrations": self.demonstrations,
            "episodes": self.episodes,
            "expert": asdict(self.expert),
            "airl": asdict(self.airl),
            "normaliser": asdict(self.normaliser),
            "moral": asdict(self.moral),
        }

    def _run(self, directory: RunDirectory, setting: pipeline.Setting, console: Console) -> dict[str, Any]:
        world = WorldSpec("emergency")
        seeds = pipeline.spawn_seeds(self.seed, 5)
        stages = {name: RunDirectory(self.out / name) for name in ("expert", "airl", "moral")}
        recorded = self.out / "demonstrations.npz"

        expert = pipeline.expert(stages["expert"], world, (0.0, 1.0), self.expert, seeds[0], setting)
        demonstrations = pipeline.demonstrate(
            stages["expert"].policy, recorded, self.demonstrations, seeds[1], setting
        )
        airl = pipeline.airl(stages["airl"], recorded, self.airl, seeds[2], setting)
        run = MoralRun(
            (stages["airl"].path,), world, seed=seeds[3], config=self.moral, normaliser=self.normaliser
        )
        moral = pipeline.moral(stages["moral"], run, setting)
        clock = time.perf_counter()
        with setting.stage("evaluation"):
            policy, _ = load_policy(stages["moral"].policy, setting.device)
            found = pipeline.evaluate(policy, world, self.episodes, seeds[4])
            assert found.optimum is not None
            metrics = read_lines(stages["moral"].metrics)
            plot_front(
                self.out / "front.png",
                found.starts,
                world.build().horizon,
                metrics,
                found.objectives,
                found.optimum,
            )
        done = {"expert": expert, "demonstrations": demonstrations, "airl": airl}
        env_steps = {name: stage["env_steps"] for name, stage in done.items()} | moral["env_steps"]
        seconds = {name: stage["wall_seconds"] for name, stage in done.items()} | moral["wall_seconds"]
        seconds["evaluation"] = round(time.perf_counter() - clock, 3)
        summary = {
            **found.objectives,
            "queries": moral["queries"],
            "seed": self.seed,
            "env_steps": {**env_steps, "total": sum(env_steps.values())},
            "wall_seconds": {**seconds, "total": round(time.perf_counter() - console.started, 3)},
            "optimum": found.optimum,
            "standard_errors": found.standard_errors,
            "weights": moral["weights"],
            "config": self._config(),
            "versions": versions(),
            "commit": commit(),
            "platform": {
                "system": f"{platform.system()} {platform.machine()}",
                "cores": os.cpu_count(),
                "device": setting.device,
                "threads": torch.get_num_threads(),
            },
        }
        write_json(directory.summary, summary)
        return summary


def _show(console: Console, out: Path, summary: dict[str, Any]) -> None:
    steps, seconds, optimum = summary["env_steps"], summary["wall_seconds"], summary["optimum"]
    console.table(
        f"Emergency: {summary['config']['episodes']} episodes from seeded starts",
        ("", "people saved", "goal time", "preferences", "environment steps"),
        (
            _row("MORAL, this run", summary, f"{summary['queries']}", f"{steps['total'] / 1e6:.2f} M"),
            _row("MORAL, thesis", THESIS["MORAL"], "25", "3 M + 3 M"),
            _row("DRLHP, thesis", THESIS["DRLHP"], "1000", "12 M"),
            _row("exact optimum", optimum, "", ""),
        ),
    )
    console.table(
        "Stages of this run",
        ("", "environment steps", "seconds"),
        [
            (name, f"{steps[name]:,}" if name in steps else "", f"{took:.1f}")
            for name, took in seconds.items()
        ],
    )
    console.print(
        f"{out} holds summary.json, front.png and the stages; see the agent: moral watch --run {out}"
    )


def _row(name: str, objectives: dict[str, Any], *others: str) -> tuple[str, ...]:
    return name, f"{objectives['people_saved']:.2f}", f"{objectives['goal_time']:.2f}", *others


def _require_demo(directory: RunDirectory) -> None:
    """Raise a StorageError if a folder holds anything but a demo, finished or not."""
    try:
        # A demo that was killed at once may have left no more than these.
        ours = ("run.lock", ".config.json.")
        found = [path for path in directory.path.iterdir() if not path.name.startswith(ours)]
    except FileNotFoundError:
        return
    except OSError as error:
        raise StorageError(f"cannot use {directory.path} as a run directory: {error.strerror}") from error
    if directory.config.exists():
        require_kind(directory, directory.read_config(), "demo")
    elif found:
        raise StorageError(f"{directory.path} is not empty and holds no demo; choose another folder")


def _clear(directory: RunDirectory) -> None:
    """Remove what an earlier demo left; other files stay."""
    for folder in (directory.path / name for name in _MADE):
        if folder != directory.path and folder.exists():
            with RunDirectory(folder).hold():
                pass
    for name, files in _MADE.items():
        folder = directory.path / name
        for file in files:
            (folder / file).unlink(missing_ok=True)
        for path in folder.glob("tensorboard/events.out.tfevents.*"):
            path.unlink()
        for emptied in (folder / "tensorboard", folder):
            with suppress(OSError):
                emptied.rmdir()

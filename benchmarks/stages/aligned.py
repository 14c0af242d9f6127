"""Agents aligned by MORAL: on learned norms and primary rewards, under weights learned from preferences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.harness import Run, Workspace
from benchmarks.stages.measuring import curve, measure, stage_seed
from benchmarks.stages.norms import LearnedNorm
from moral_algorithms import pipeline
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.inference import InferenceConfig, make_posterior
from moral_algorithms.learners.moral import MoralConfig
from moral_algorithms.pipeline.reward_vector import pursue_alone
from moral_algorithms.preferences import Preference
from moral_algorithms.preferences.priors import normalise_rows
from moral_algorithms.run_directory import RunDirectory, read_lines
from moral_algorithms.worlds import WorldSpec

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_EVERY = 5
"""Answers between two snapshots of the posterior."""


@dataclass(frozen=True)
class PrimaryReturn(Run):
    """What a policy earns that pursues one primary component alone: the component's normaliser (eq. 5.2)."""

    world: WorldSpec
    """Where it acts."""
    component: str
    """Which component of the world's reward vector."""
    seed: int
    """Which of several."""
    config: ExpertConfig = field(default_factory=pipeline.normaliser_config)
    """How the policy is trained."""

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Train the policy and average its returns."""
        seed = stage_seed(self.seed, "primary")
        found = pursue_alone(self.world, self.component, self.config, seed, pipeline.Setting())
        return {name: found[name] for name in ("return", "env_steps")} | {"seconds": found["wall_seconds"]}


@dataclass(frozen=True)
class Aligned(Run):
    """One training with MORAL (algorithm 5; algorithm 1 for one norm)."""

    norms: tuple[LearnedNorm, ...]
    """Learned rewards, the components learned_1, learned_2 and so on."""
    teacher: pipeline.TeacherConfig
    """Who answers."""
    seed: int
    """Which of several."""
    primary: tuple[PrimaryReturn, ...] = ()
    """Primary components, each with its normaliser."""
    primary_scale: float = 1.0
    """What the normalised primary components are multiplied with."""
    config: MoralConfig = field(default_factory=MoralConfig)
    """How MORAL trains and asks."""
    episodes: int = 500
    """Episodes over which the agent is measured."""

    def needs(self) -> tuple[Run, ...]:
        """Name the norms and the normalisers."""
        return (*self.norms, *self.primary)

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Train the agent, or go on training it, and measure it."""
        directory = RunDirectory(workspace.folder)
        returns = {
            one.component: workspace.result_of(one)["return"] / self.primary_scale for one in self.primary
        }
        run = pipeline.MoralRun(
            rewards=tuple(workspace.of(norm) for norm in self.norms),
            world=self.norms[0].expert.world,
            primary=tuple(returns),
            returns=returns,
            teacher=self.teacher,
            seed=stage_seed(self.seed, "moral"),
            config=self.config,
        )
        resume = directory.config.exists()
        summary = pipeline.moral(directory, run, pipeline.Setting(), resume=resume)
        lines = read_lines(directory.metrics)
        dim = len(self.primary) + len(self.norms)
        return {
            **measure(directory.policy, self.episodes),
            "weights": summary["weights"],
            "path": path(lines),
            "posterior": posteriors(self.config, dim, read_lines(directory.queries)),
            "curve": curve(lines, ("queries",)),
            "env_steps": summary["env_steps"]["moral"],
            "seconds": summary["wall_seconds"]["moral"],
            "whole": not resume,
        }


def posteriors(
    config: InferenceConfig, dim: int, answers: Sequence[dict[str, Any]]
) -> dict[str, dict[str, list[Any]]]:
    """Follow the posterior over ``dim`` weights.

    Returns
    -------
    dict
        Marginal quantiles and mean of the weights after every fifth answer, by the number of answers.
    """
    posterior = make_posterior(config, dim, np.random.default_rng(0))
    found = {}
    for number, answer in enumerate(answers, start=1):
        posterior.add(np.array(answer["returns"]), Preference(answer["preference"]))
        if number % _EVERY == 0 or number == len(answers):
            weights = normalise_rows(posterior.samples)
            found[str(number)] = {
                "mean": posterior.weights().round(4).tolist(),
                "quantiles": np.quantile(weights, _QUANTILES, axis=0).round(4).tolist(),
            }
    return found


def path(lines: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Where training stood when each query was answered, and at the end."""
    found = []
    for before, line in pairwise(lines):
        if line["queries"] > before["queries"]:
            found.append(before)
    found += lines[-1:]
    return [
        {name: line[name] for name in ("env_steps", "queries", "weights", "objectives")} for line in found
    ]

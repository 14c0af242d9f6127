"""T1: what four methods can do, measured in Emergency (thesis table 6.1).

The table has a tick, a cross or a wave for each of four capabilities of ethics shaping, policy orchestration,
DRLHP and MORAL. Here each cell is a score from runs; a tick is at least 0.9, a wave at least 0.5.

All learn from the same demonstrators: an expert who saves people and one who stands by the extinguisher. Each
method has a knob, and is judged by the best policy over its settings: for ethics shaping the scale c_n = c_p,
for policy orchestration lambda, for MORAL and DRLHP what the teacher prefers: in 25 answers to MORAL and in
1,000, as in the thesis, to DRLHP.

Function approximation
    People saved, as a share of those there are, from raw planes. The baselines' tables and bandits get the
    planes instead of features made by hand; the other two never get anything else. The arms of policy
    orchestration are networks here, so its cell is about the orchestrator alone.
Multi-objective
    Given a primary reward for the extinguisher and the norm to save people: the worst of three wishes, each
    over the knob. They are goal time alone, people saved alone (shares of what can be reached) and both (the
    smaller share of the two at the policy that saves all it can and then has most goal time). DRLHP is given
    neither reward, as it has no place for one: its wishes are taught by the teacher alone.
Multiple experts
    Given both experts and no primary reward: the wish for both. Ethics shaping can only pool them. DRLHP
    takes no demonstrations, so it scores 0 by its interface.
Outperform experts
    People saved, over those saved in the demonstrations; a tick if this is above 1 in every seed. Nobody can
    save more than an expert who saves everyone: here half of the expert's actions are random. DRLHP is
    compared with the same demonstrations, which it has not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Benchmark, Check, Profile, Results, Run, Workspace
from benchmarks.harness.statistics import spread
from benchmarks.stages import Aligned, FromPreferences, LearnedNorm, PrimaryReturn
from benchmarks.stages.measuring import EVALUATION_SEED, measure
from benchmarks.stages.settings import (
    EMERGENCY,
    SAVE_FIRST,
    drlhp,
    emergency_moral,
    episodes,
    primary,
    saving,
    seeds,
)
from moral_algorithms.bridge import LearnedReward, PrimaryReward, RewardComponent
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.evaluation import Policy, RandomPolicy
from moral_algorithms.learners.ethics_shaping import EthicsShapingConfig, train_ethics_shaping
from moral_algorithms.learners.policy_orchestration import (
    Arm,
    ArmConfig,
    OrchestrationConfig,
    train_arm,
    train_orchestrator,
)
from moral_algorithms.networks.files import load_policy, load_reward, save_policy
from moral_algorithms.pipeline import TeacherConfig, evaluate, spawn_seeds
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.worlds import WorldSpec
from moral_envs import optimal

METHODS = ("ethics shaping", "policy orchestration", "DRLHP", "MORAL")
CAPABILITIES = ("function approximation", "multi-objective", "multiple experts", "outperform experts")
_PLANES, _FRONT, _EXPERTS, _OUTDO = CAPABILITIES

THESIS = {_PLANES: "✗✗✓✓", _FRONT: "✗✓✗✓", _EXPERTS: "✗~✗✓", _OUTDO: "✓✓✓✓"}
"""Table 6.1: a mark for each method, in the order of METHODS."""

FIRE = (1.0, 0.0)
"""Weights of (extinguish, save) of the second expert, who stands by the extinguisher."""

# The opposite of the teacher who wants people saved first.
_FIRE_FIRST = TeacherConfig(order=("goal_time", "people_saved"))
_RANDOM_ACTIONS = 0.5
# Settings of the baselines' knobs: c_n = c_p, and the share of the primary reward or of the second expert.
_SCALES = (0.0, 0.3, 1.0, 3.0)
_SHARES = (0.0, 0.05, 0.1, 0.2, 0.3, 1.0)


@dataclass(frozen=True)
class Reachable(Run):
    """What can be reached at best on the starts that all are measured on."""

    world: WorldSpec
    """Emergency, of any size."""
    episodes: int = 500
    """Starts."""

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Compute the optimum with people first, and that with nothing but goal time."""
        world = self.world.build()
        chance = RandomPolicy(world.num_actions, np.random.default_rng(0))
        found = evaluate(chance, self.world, self.episodes, EVALUATION_SEED)
        fire_alone = optimal.best_returns(found.starts, world.horizon, (1.0, 0.0)).mean(axis=0)
        return {"both": found.optimum, "goal_time": float(fire_alone[0]), "chance": found.objectives}


@dataclass(frozen=True)
class Shaped(Run):
    """One training with ethics shaping, on the demonstrations of one expert or of several, pooled."""

    norms: tuple[LearnedNorm, ...]
    """Whose demonstrations; nothing is learned from them before."""
    seed: int
    """Which of several."""
    config: EthicsShapingConfig
    """How it learns."""
    episodes: int = 500
    """Episodes over which it is measured."""

    def needs(self) -> tuple[Run, ...]:
        """Name the experts."""
        return tuple(norm.expert for norm in self.norms)

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Record the experts, train the agent and measure it."""
        recorded = []
        for number, norm in enumerate(self.norms):
            path = workspace.folder / f"demonstrations_{number}.npz"
            norm.record(workspace.of(norm.expert), path)
            recorded.append(Demonstrations.load(path))
        world = recorded[0].world
        pooled = Demonstrations(
            world,
            *(
                np.concatenate([getattr(one, name) for one in recorded])
                for name in ("states", "actions", "objectives")
            ),
        )
        (seed,) = spawn_seeds(self.seed, 1)
        agent = train_ethics_shaping(pooled, self.config, seed)
        return {
            **_measured(agent.policy, world, self.episodes),
            "states": agent.states,
            "env_steps": agent.env_steps,
        }


@dataclass(frozen=True)
class TrainedArm(Run):
    """A policy that pursues one normalised reward alone. It leaves the policy."""

    leaves_files: ClassVar[bool] = True

    source: LearnedNorm | PrimaryReturn
    """Where the reward and its normaliser come from."""
    seed: int
    """Which of several."""
    config: ArmConfig = field(default_factory=ArmConfig)
    """How it is trained."""
    episodes: int = 500
    """Episodes over which it is measured."""

    def needs(self) -> tuple[Run, ...]:
        """Name the reward's source."""
        return (self.source,)

    @property
    def world(self) -> WorldSpec:
        """Where it acts."""
        source = self.source
        return source.world if isinstance(source, PrimaryReturn) else source.expert.world

    def reward(self, workspace: Workspace) -> RewardComponent:
        """Make the reward, normalised by the return of who pursues it (eq. 5.2)."""
        source = self.source
        if isinstance(source, PrimaryReturn):
            scale = 1 / workspace.result_of(source)["return"]
            return PrimaryReward(self.world.build().reward_names, source.component, scale)
        network, normaliser, _ = load_reward(workspace.of(source) / "reward.safetensors")
        return LearnedReward(f"learned_{source.expert.weights}", network, 1 / normaliser)

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Train the policy and measure it."""
        directory = RunDirectory(workspace.folder)
        (seed,) = spawn_seeds(self.seed, 1)
        policy = train_arm(self.world, self.reward(workspace), self.config, seed)
        save_policy(directory.policy, policy, self.config.ppo.policy, self.world)
        return {**measure(directory.policy, self.episodes), "env_steps": self.config.steps}


@dataclass(frozen=True)
class Orchestrated(Run):
    """One training of an orchestrator over two arms."""

    arms: tuple[TrainedArm, TrainedArm]
    """Whose policies it chooses from."""
    share: float
    """What the first arm's reward counts for; that of the second counts for the rest."""
    seed: int
    """Which of several."""
    config: OrchestrationConfig
    """How it learns."""
    episodes: int = 500
    """Episodes over which it is measured."""

    def needs(self) -> tuple[Run, ...]:
        """Name the arms, and what their rewards come from."""
        return (*self.arms, *(arm.source for arm in self.arms))

    def execute(self, workspace: Workspace) -> dict[str, Any]:
        """Train the orchestrator and measure it."""
        arms = [
            Arm(load_policy(RunDirectory(workspace.of(arm)).policy).policy, arm.reward(workspace))
            for arm in self.arms
        ]
        world = self.arms[0].world
        (seed,) = spawn_seeds(self.seed, 1)
        found = train_orchestrator(world, arms, (self.share, 1 - self.share), self.config, seed)
        return {**_measured(found.policy, world, self.episodes), "env_steps": found.env_steps}


def runs(profile: Profile) -> list[Run]:
    """List the runs of a profile."""
    found: list[Run] = [Reachable(EMERGENCY, episodes(profile))]
    for seed in seeds(profile):
        found += _runs_of_seed(profile, seed)
    return found


def _runs_of_seed(profile: Profile, seed: int) -> Iterator[Run]:
    measured = episodes(profile)
    save = saving(profile, seed)
    fire = replace(save, expert=replace(save.expert, weights=FIRE))
    clumsy = replace(save, random_actions=_RANDOM_ACTIONS)
    yield from (save, fire, clumsy)

    scales = (0.0, 3.0) if profile == "smoke" else _SCALES
    shaping = replace(EthicsShapingConfig(), steps=6400) if profile == "smoke" else EthicsShapingConfig()

    def shaped(scale: float, *norms: LearnedNorm, **changes: Any) -> Shaped:
        return Shaped(norms, seed, replace(shaping, penalty=scale, bonus=scale, **changes), measured)

    for scale in scales:
        yield shaped(scale, save)
        yield shaped(scale, clumsy)
        # Unshaped, these learn nothing of the demonstrations.
        if scale > 0:
            yield shaped(scale, save, features="planes")
            yield shaped(scale, save, fire, primary=())

    extinguish = primary(profile, EMERGENCY, "extinguish", seed)
    arm = replace(ArmConfig(), steps=6400) if profile == "smoke" else ArmConfig()
    selfish, saver, keeper, clumsy_saver = (
        TrainedArm(one, seed, arm, measured) for one in (extinguish, save, fire, clumsy)
    )
    shares = (0.05, 1.0) if profile == "smoke" else _SHARES
    bandit = OrchestrationConfig()
    if profile == "smoke":
        bandit = replace(bandit, steps=6400, value_episodes=20)
    for share in shares:
        for arms in ((selfish, saver), (keeper, saver), (selfish, clumsy_saver)):
            yield Orchestrated(arms, share, seed, bandit, measured)
        # From planes it is only asked how many people it saves, for which the other end is no help.
        if share < max(shares):
            planes = replace(bandit, context="planes")
            yield Orchestrated((selfish, saver), share, seed, planes, measured)

    moral = emergency_moral(profile)
    for teacher in (SAVE_FIRST, _FIRE_FIRST):
        preferring = drlhp(profile, EMERGENCY, 1000)
        yield FromPreferences(EMERGENCY, teacher, seed, preferring, episodes=measured)
        yield Aligned((save,), teacher, seed, (extinguish,), config=moral, episodes=measured)
    yield Aligned((save, fire), SAVE_FIRST, seed, config=moral, episodes=measured)
    yield Aligned((clumsy,), SAVE_FIRST, seed, (extinguish,), config=moral, episodes=measured)


def _measured(policy: Policy, world: WorldSpec, episodes: int) -> dict[str, Any]:
    """Measure a policy on the starts that all are measured on."""
    found = evaluate(policy, world, episodes, EVALUATION_SEED)
    return {"objectives": found.objectives, "standard_errors": found.standard_errors}


# Mean objectives of policies, by name.
_Policies = list[dict[str, float]]


def _policies(results: Results) -> dict[str, dict[int, dict[str, _Policies]]]:
    """Sort the policies by method, seed and the capability that they tell of."""
    methods: dict[str, tuple[list[Any], Callable[[Any], tuple[str, ...]]]] = {
        "ethics shaping": (results.of(Shaped), _asked_of_shaped),
        "policy orchestration": (results.of(Orchestrated), _asked_of_orchestrated),
        "DRLHP": (results.of(FromPreferences), lambda _: (_PLANES, _FRONT, _OUTDO)),
        "MORAL": (results.of(Aligned), _asked_of_aligned),
    }
    found: dict[str, dict[int, dict[str, _Policies]]] = {}
    for method, (trained, asked) in methods.items():
        by_seed = found.setdefault(method, {})
        for run, result in trained:
            for capability in asked(run):
                by_seed.setdefault(run.seed, {}).setdefault(capability, []).append(result["objectives"])
    return found


def _asked_of_shaped(run: Shaped) -> tuple[str, ...]:
    if len(run.norms) > 1:
        return (_EXPERTS,)
    if run.config.features == "planes":
        return (_PLANES,)
    return (_OUTDO,) if run.norms[0].random_actions else (_FRONT,)


def _asked_of_orchestrated(run: Orchestrated) -> tuple[str, ...]:
    first, second = (arm.source for arm in run.arms)
    if isinstance(first, LearnedNorm):
        return (_EXPERTS,)
    if run.config.context == "planes":
        return (_PLANES,)
    return (_OUTDO,) if isinstance(second, LearnedNorm) and second.random_actions else (_FRONT,)


def _asked_of_aligned(run: Aligned) -> tuple[str, ...]:
    if len(run.norms) > 1:
        return (_EXPERTS,)
    return (_OUTDO,) if run.norms[0].random_actions else (_PLANES, _FRONT)


def _reachable(results: Results) -> dict[str, Any] | None:
    """Find what can be reached at best; None while that run is not done."""
    return next((result for _, result in results.of(Reachable)), None)


def scores(results: Results) -> dict[tuple[str, str], list[float]]:
    """Compute the score of each capability and method, one per seed; see the module's documentation."""
    reachable = _reachable(results)
    if reachable is None:
        return {}
    both, most_fire = reachable["both"], reachable["goal_time"]
    people = both["people_saved"]
    demonstrated = {
        run.seed: result["demonstrated"]["people_saved"]
        for run, result in results.of(LearnedNorm)
        if run.random_actions
    }

    def saved(policies: _Policies) -> float:
        return float(max(one["people_saved"] for one in policies) / people)

    def compromise(policies: _Policies) -> float:
        return float(max(min(one[name] / both[name] for name in both) for one in policies))

    def goal_time(policies: _Policies) -> float:
        return float(max(one["goal_time"] for one in policies) / most_fire)

    found: dict[tuple[str, str], list[float]] = {}
    for method, by_seed in _policies(results).items():
        for seed, told in by_seed.items():
            cells: dict[str, float] = {}
            if _PLANES in told:
                cells[_PLANES] = saved(told[_PLANES])
            if _FRONT in told:
                front = told[_FRONT]
                cells[_FRONT] = min(goal_time(front), saved(front), compromise(front))
            if _EXPERTS in told:
                cells[_EXPERTS] = compromise(told[_EXPERTS])
            elif method == "DRLHP":
                cells[_EXPERTS] = 0.0
            if _OUTDO in told and seed in demonstrated:
                cells[_OUTDO] = saved(told[_OUTDO]) * people / demonstrated[seed]
            for capability, score in cells.items():
                found.setdefault((capability, method), []).append(score)
    return found


def mark(capability: str, values: list[float]) -> str:
    """Turn the scores of the seeds into a tick, a wave or a cross."""
    if capability == _OUTDO:
        return "✓" if min(values) > 1 else "✗"
    mean = float(np.mean(values))
    return "✓" if mean >= 0.9 else "~" if mean >= 0.5 else "✗"


def judge(results: Results) -> list[Check]:
    """Compare every cell of the table with its measurement."""
    checks = []
    found = scores(results)
    for capability in CAPABILITIES:
        for method, stated in zip(METHODS, THESIS[capability], strict=True):
            values = found.get((capability, method))
            if values is None:
                continue
            measured = mark(capability, values)
            why = " (takes no demonstrations)" if (capability, method) == (_EXPERTS, "DRLHP") else ""
            checks.append(
                Check(
                    statement=f"{capability}, {method}: {stated}",
                    value=f"{measured} {spread(values)}{why}",
                    met=measured == stated,
                    of="thesis",
                )
            )
    return checks


def draw(results: Results) -> Figure:
    """Draw what each method's knob reaches, and the table with its scores."""
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    front, table = figure.subplots(1, 2, width_ratios=(1, 1.35))
    for method, marker in zip(METHODS, "osv*", strict=True):
        by_seed = _policies(results)[method].values()
        policies = [one for told in by_seed for one in told.get(_FRONT, [])]
        front.scatter(
            [one["people_saved"] for one in policies],
            [one["goal_time"] for one in policies],
            marker=marker,
            label=method,
            alpha=0.8,
        )
    reachable = _reachable(results)
    if reachable is not None:
        both = reachable["both"]
        place = [both["people_saved"]], [both["goal_time"]]
        front.scatter(*place, marker="+", s=120, color="black", label="exact optimum")
    front.set(xlabel="people saved", ylabel="goal time (steps)", title="Policies over each method's knob")
    front.legend(fontsize=8)

    found = scores(results)
    table.set_axis_off()
    table.set_title("Score and measured mark (the thesis's mark)")
    cells, colours = [], []
    for capability in CAPABILITIES:
        row, shades = [], []
        for method, stated in zip(METHODS, THESIS[capability], strict=True):
            values = found.get((capability, method))
            measured = "" if values is None else mark(capability, values)
            row.append("" if values is None else f"{np.mean(values):.2f}  {measured}  ({stated})")
            shades.append("white" if values is None else "#dff0d8" if measured == stated else "#fbe3d6")
        cells.append(row)
        colours.append(shades)
    drawn = table.table(
        cells,
        cellColours=colours,
        rowLabels=[name.replace(" ", "\n", 1) for name in CAPABILITIES],
        colLabels=[name.replace(" ", "\n", 1) for name in METHODS],
        cellLoc="center",
        bbox=(0.12, 0.0, 0.88, 1.0),
    )
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(9)
    return figure


BENCHMARK = Benchmark(
    id="T1",
    title="What four methods can do",
    source="table 6.1",
    claim="Only MORAL has all four: function approximation, several objectives, several experts, and "
    "policies that outperform their experts.",
    bar="The two baselines small but real, so that the table is measured.",
    runs=runs,
    judge=judge,
    draw=draw,
    changed="Half-random demonstrators served all four questions first, and learners had fewer steps: MORAL "
    "failed two of them then. Then DRLHP had 25 answers for several objectives, and ethics shaping one scale "
    "for planes and for several experts. MORAL's likelihood expected no random answers first (see E7).",
)

"""Preferences about episodes of a random policy, then PPO: what active queries must beat."""

import time
from dataclasses import dataclass

import numpy as np

from benchmarks.harness import Run, Workspace
from benchmarks.rows.e8 import CONTENDERS
from benchmarks.stages.measuring import curve, measure
from benchmarks.stages.settings import EMERGENCY, SAVE_FIRST
from moral_algorithms.evaluation import RandomPolicy, play_episodes
from moral_algorithms.learners.expert import ExpertConfig, train_expert
from moral_algorithms.learners.ppo import Progress
from moral_algorithms.networks.files import save_policy
from moral_algorithms.preferences import BradleyTerry, Posterior, Query, RationalityPrior
from moral_envs.world import NUM_ACTIONS


@dataclass(frozen=True)
class OneBatch(Run):
    """All that the result depends on; its hash names the record."""

    seed: int
    queries: int = 25
    steps: int = 600_000
    episodes: int = 1000

    def execute(self, workspace: Workspace) -> dict[str, object]:
        """Learn weights of the world's rewards, train under them and measure."""
        started = time.perf_counter()
        rng = np.random.default_rng(self.seed)
        world = EMERGENCY.build()
        played = play_episodes(RandomPolicy(NUM_ACTIONS, rng), world, 2 * self.queries, self.seed)
        teacher = SAVE_FIRST.build(world.objective_names, rng)
        scale = played.returns.max(axis=0)  # components of one size, for the likelihood
        posterior = Posterior(RationalityPrior(len(scale)), BradleyTerry(), rng=rng)
        returns = (played.returns / scale).reshape(-1, 2, 2)
        for pair, objectives in zip(returns, played.objectives.reshape(-1, 2, 2), strict=True):
            posterior.add(pair, teacher.prefer(Query(pair, objectives)))

        lines: list[dict[str, object]] = []

        def remember(now: Progress) -> None:
            lines.append({"env_steps": now.steps, "objectives": now.objectives})

        config = ExpertConfig(max_steps=self.steps)
        weights = posterior.weights() / scale
        trained = train_expert(EMERGENCY, weights, config, self.seed, on_progress=remember)
        seconds, steps = time.perf_counter() - started, played.actions.size + trained.env_steps
        costs = {"env_steps": steps, "seconds": seconds, "preferences": self.queries}
        path = workspace.folder / "policy.safetensors"
        save_policy(path, trained.policy, config.ppo.policy, EMERGENCY)
        return {**measure(path, self.episodes), **costs, "curve": curve(lines)}


SMOKE = {"steps": 19_200, "episodes": 20}
CONTENDERS["one batch"] = lambda profile, seed: OneBatch(seed, **(SMOKE if profile == "smoke" else {}))

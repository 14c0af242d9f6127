"""How every stage is trained in each world and profile: the same for all seeds and for all benchmarks.

*laptop* takes the package's defaults where they were made for a world, and what was found on development
seeds (100 and above) elsewhere. *paper* takes the thesis's networks, samplers and numbers of steps (appendix
B). *smoke* is too short to learn anything: it shows that everything runs.
"""

from __future__ import annotations

from dataclasses import replace

from benchmarks.harness import Profile
from benchmarks.stages.aligned import PrimaryReturn
from benchmarks.stages.covered import Covered
from benchmarks.stages.norms import LearnedNorm, TrainedExpert
from moral_algorithms.learners.airl import AIRLConfig
from moral_algorithms.learners.alignment import AlignmentConfig
from moral_algorithms.learners.coverage import CoverageConfig
from moral_algorithms.learners.covering import CoveringConfig
from moral_algorithms.learners.drlhp import DRLHPConfig
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.moral import MoralConfig
from moral_algorithms.learners.ppo import PPOConfig
from moral_algorithms.pipeline import (
    TeacherConfig,
    airl_config,
    drlhp_preset,
    expert_config,
    normaliser_config,
)
from moral_algorithms.worlds import WorldSpec

EMERGENCY = WorldSpec("emergency")
WAREHOUSE = WorldSpec("burning_warehouse")
DELIVERY = WorldSpec("delivery")

SAVE = (0.0, 1.0)
"""Weights of (extinguish, save) of the experts of Emergency and Burning Warehouse."""
HELP = (0.0, 1.0, 0.0, 1.0)
CLEAN = (0.0, 0.0, 1.0, 1.0)
"""Weights of (deliver, help, clean, vase) of Delivery's experts, who both spare the vases (figure A.3)."""

SAVE_FIRST = TeacherConfig(order=("people_saved", "goal_time"))
"""Emergency's teacher: more people saved and, on a tie, more goal time (section 4.2)."""

_SMOKE = PPOConfig(num_envs=128, batch_size=3200, epochs=1)
# Two episodes of Emergency, or three of Delivery, in every environment.
_SMOKE_STEPS = 19_200
# Of one policy of a coverage set.
_DELIVERY_STEPS = 800_000


def seeds(profile: Profile, count: int = 3) -> range:
    """Seeds of a benchmark; one is enough to see whether everything runs."""
    return range(1 if profile == "smoke" else count)


def episodes(profile: Profile) -> int:
    """Episodes over which a final policy is measured."""
    return 20 if profile == "smoke" else 1000


def saver(profile: Profile, seed: int) -> TrainedExpert:
    """Emergency's expert, who saves people."""
    return TrainedExpert(EMERGENCY, SAVE, seed, _expert(ExpertConfig(), profile), episodes(profile))


def saving(profile: Profile, seed: int, demonstrations: int = 1000) -> LearnedNorm:
    """Learn the norm of Emergency's expert by AIRL."""
    count = min(demonstrations, 20) if profile == "smoke" else demonstrations
    config = AIRLConfig()
    if profile == "paper":
        config = replace(config, steps=3_000_000, architecture="conv", ppo=_paper(config.ppo))
    return LearnedNorm(saver(profile, seed), seed, count, _airl(config, profile), episodes(profile))


def rescuer(profile: Profile, seed: int) -> TrainedExpert:
    """Burning Warehouse's expert, who picks people up."""
    return TrainedExpert(WAREHOUSE, SAVE, seed, _expert(ExpertConfig(), profile), episodes(profile))


def single_loop(profile: Profile) -> AIRLConfig:
    """AIRL and the primary reward in a single loop, in Burning Warehouse, for as long as in the paper."""
    config = AIRLConfig(steps=1_000_000)
    if profile == "paper":
        config = replace(config, architecture="conv", ppo=_paper(config.ppo))
    return _airl(config, profile)


def helper_or_cleaner(profile: Profile, weights: tuple[float, ...], seed: int) -> TrainedExpert:
    """One of Delivery's experts."""
    config = _expert(expert_config(DELIVERY.name), profile)
    return TrainedExpert(DELIVERY, weights, seed, config, episodes(profile))


def helping_and_cleaning(profile: Profile, seed: int) -> tuple[LearnedNorm, LearnedNorm]:
    """Learn the norms of Delivery's two experts by AIRL."""
    config = airl_config(DELIVERY.name)
    if profile == "paper":
        config = replace(config, steps=6_000_000, architecture="conv", ppo=_paper(config.ppo))
    count = 20 if profile == "smoke" else 1000

    def learned(weights: tuple[float, ...]) -> LearnedNorm:
        expert = helper_or_cleaner(profile, weights, seed)
        return LearnedNorm(expert, seed, count, _airl(config, profile), episodes(profile))

    return learned(HELP), learned(CLEAN)


def primary(profile: Profile, world: WorldSpec, component: str, seed: int) -> PrimaryReturn:
    """Normaliser of a primary component."""
    return PrimaryReturn(world, component, seed, _expert(normaliser_config(world.name), profile))


def emergency_moral(profile: Profile, queries: int = 25) -> MoralConfig:
    """MORAL in Emergency."""
    config = replace(MoralConfig(), queries=queries)
    return _moral(config, profile, paper_steps=3_000_000)


def delivery_moral(profile: Profile) -> MoralConfig:
    """MORAL in Delivery, trained along with the queries."""
    config = MoralConfig(steps=2_000_000, ppo=PPOConfig(entropy_start=0.03, entropy_end=0.005))
    return _moral(config, profile, paper_steps=8_000_000)


def covered(profile: Profile, seed: int, with_primary: bool = True) -> Covered:
    """One policy for all weights of (deliver, f_help, f_clean) in Delivery, or of the norms alone.

    That of the norms alone takes as many steps as the eleven policies together that D4 sets beside it.
    """
    config = CoveringConfig()
    if profile == "smoke":
        config = replace(config, steps=_SMOKE_STEPS, ppo=_SMOKE)
    elif not with_primary:
        config = replace(config, steps=11 * _DELIVERY_STEPS)
    given = (primary(profile, DELIVERY, "deliver", seed),) if with_primary else ()
    return Covered(helping_and_cleaning(profile, seed), seed, given, config)


def asking(profile: Profile, queries: int = 25) -> AlignmentConfig:
    """How a teacher who wants a ratio is asked about a policy for all weights."""
    config = AlignmentConfig(queries=queries, centred=0.05)
    if profile == "smoke":
        return replace(config, queries=min(queries, 6), candidates=50, samples=100, episodes=8)
    return config


def coverage(profile: Profile, steps: int, paper_steps: int) -> CoverageConfig:
    """One policy of a coverage set, in either world."""
    config = CoverageConfig(steps, episodes(profile))
    if profile == "smoke":
        return replace(config, steps=_SMOKE_STEPS, ppo=_SMOKE)
    if profile == "paper":
        return replace(config, steps=paper_steps, ppo=_paper(config.ppo))
    return config


def delivery_coverage(profile: Profile) -> CoverageConfig:
    """One policy of a coverage set in Delivery."""
    config = coverage(profile, _DELIVERY_STEPS, paper_steps=8_000_000)
    if profile == "laptop":
        # As large steps as the policy for all weights takes.
        learning_rate = CoveringConfig().ppo.learning_rate
        return replace(config, ppo=replace(config.ppo, learning_rate=learning_rate))
    return config


def drlhp(profile: Profile, world: WorldSpec, queries: int) -> DRLHPConfig:
    """DRLHP in either world."""
    config = replace(drlhp_preset("paper" if profile == "paper" else "fast", world), queries=queries)
    if profile == "smoke":
        reward = replace(config.reward, members=1, initial_updates=20, updates=2)
        # A rollout more, which learns from the answers about the policy that is being trained.
        steps = _SMOKE_STEPS + _SMOKE.num_envs * _SMOKE.rollout_steps
        config = replace(config, steps=steps, queries=min(queries, 12), reward=reward, ppo=_SMOKE)
    return config


def _expert(config: ExpertConfig, profile: Profile) -> ExpertConfig:
    if profile == "smoke":
        return replace(config, max_steps=_SMOKE_STEPS, window=_SMOKE_STEPS, ppo=_SMOKE)
    return config


def _airl(config: AIRLConfig, profile: Profile) -> AIRLConfig:
    if profile == "smoke":
        config = replace(config, steps=_SMOKE_STEPS, discriminator_updates=2, normaliser_episodes=20)
        return replace(config, ppo=_SMOKE)
    return config


def _moral(config: MoralConfig, profile: Profile, paper_steps: int) -> MoralConfig:
    if profile == "smoke":
        queries = min(config.queries, 6)
        return replace(config, steps=_SMOKE_STEPS, queries=queries, candidates=50, samples=100, ppo=_SMOKE)
    if profile == "paper":
        return replace(
            config,
            steps=paper_steps,
            acquisition="volume_removal",
            prior="ball",
            likelihood="exponential",
            lapse=0.0,
            sampler="metropolis",
            ppo=_paper(config.ppo),
        )
    return config


def _paper(config: PPOConfig) -> PPOConfig:
    """Take the thesis's network."""
    return replace(config, policy="paper")

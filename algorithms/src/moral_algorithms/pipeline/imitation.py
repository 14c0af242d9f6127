"""The first three stages: an expert, its demonstrations and the reward that is learned from them."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from moral_algorithms.bridge.reward_vector import require_weights
from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.evaluation import CarelessPolicy, play_episodes
from moral_algorithms.learners.airl import AIRLConfig, train_airl
from moral_algorithms.learners.expert import ExpertConfig, train_expert
from moral_algorithms.learners.ppo import sampling_seed
from moral_algorithms.networks.files import load_policy, save_policy, save_reward
from moral_algorithms.pipeline.stage import (
    Setting,
    StageClock,
    name_values,
    new_run,
    require_normaliser,
    require_positive,
)
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import StorageError, write_json
from moral_algorithms.worlds import WorldSpec


def expert(
    directory: RunDirectory,
    world: WorldSpec,
    weights: tuple[float, ...],
    config: ExpertConfig,
    seed: int,
    setting: Setting,
) -> dict[str, Any]:
    """Train an expert and save its policy.

    Parameters
    ----------
    directory
        Where it goes.
    world
        Where it acts.
    weights
        Weights of the world's reward vector.
    config
        How it is trained.
    seed
        Entropy of all of it.
    setting
        How the stage is run.

    Returns
    -------
    dict
        What ``summary.json`` holds: ``env_steps``, ``wall_seconds`` and the mean ``objectives`` at the end.

    Raises
    ------
    ValueError
        If the weights do not fit the world.
    StorageError
        If the directory holds a finished run, or something cannot be written.
    """
    (training_seed,) = spawn_seeds(seed, 1)
    require_weights(weights, world.build().reward_names)
    config_json = {"world": world.to_json(), "weights": list(weights), "seed": seed, "expert": asdict(config)}
    with new_run(directory, "expert", config_json):
        clock = StageClock()
        with setting.stage("expert") as on_progress:
            trained = train_expert(
                world,
                weights,
                config,
                training_seed,
                setting.device,
                setting.event_files(directory),
                clock.watch(on_progress),
            )
        save_policy(directory.policy, trained.policy, config.ppo.policy, world)
        summary = {"env_steps": trained.env_steps, **clock.summary()}
        write_json(directory.summary, summary)
    return summary


def demonstrate(
    source: Path, path: Path, episodes: int, seed: int, setting: Setting, random_actions: float = 0.0
) -> dict[str, Any]:
    """Record episodes of an expert.

    Parameters
    ----------
    source
        The expert's policy file.
    path
        The demonstration file.
    episodes
        How many.
    seed
        Entropy of starts and actions.
    setting
        How the stage is run.
    random_actions
        Share of the actions that are random instead, as those of a careless demonstrator.

    Returns
    -------
    dict
        ``env_steps``, ``wall_seconds`` and the mean ``objectives``.

    Raises
    ------
    ValueError
        If ``episodes`` is below 1, or ``random_actions`` is no probability.
    StorageError
        If the policy cannot be read, or the file exists or cannot be written.
    """
    require_positive("episodes", episodes)
    if path.exists():
        raise StorageError(f"{path} exists; choose another name")
    policy, world = load_policy(source, setting.device)
    built = world.build()
    clock = StageClock()
    starts_seed, actions_seed = spawn_seeds(seed, 2)
    demonstrator = CarelessPolicy(
        policy, random_actions, built.num_actions, np.random.default_rng(actions_seed)
    )
    with setting.stage("demonstrations"), sampling_seed(actions_seed):
        played = play_episodes(demonstrator, built, episodes, starts_seed)
        Demonstrations(world, played.states, played.actions, played.objectives).save(path)
    objectives = name_values(built.objective_names, played.objectives.mean(axis=0))
    return {"env_steps": played.actions.size, **clock.summary(), "objectives": objectives}


def airl(
    directory: RunDirectory,
    source: Path,
    config: AIRLConfig,
    seed: int,
    setting: Setting,
    world: WorldSpec | None = None,
) -> dict[str, Any]:
    """Learn a reward network from demonstrations; save it and the imitation policy.

    Parameters
    ----------
    directory
        Where they go.
    source
        The demonstration file.
    config
        How AIRL trains.
    seed
        Entropy of all of it.
    setting
        How the stage is run.
    world
        The world that the demonstrations must be of; None takes any.

    Returns
    -------
    dict
        What ``summary.json`` holds: ``env_steps``, ``wall_seconds``, ``normaliser`` and the mean
        ``objectives`` at the end.

    Raises
    ------
    ValueError
        If the imitator's mean return is not positive: the reward is divided by it.
    StorageError
        If the demonstrations cannot be read or are of another world, the directory holds a finished run, or
        something cannot be written.
    """
    demonstrations = Demonstrations.load(source, world)
    world = demonstrations.world
    (training_seed,) = spawn_seeds(seed, 1)
    config_json = {
        "world": world.to_json(),
        "demonstrations": str(source),
        "episodes": demonstrations.num_episodes,
        "seed": seed,
        "airl": asdict(config),
    }
    with new_run(directory, "airl", config_json):
        # What an attempt that was cut off has left.
        directory.metrics.unlink(missing_ok=True)
        clock = StageClock()
        with setting.stage("airl") as on_progress:
            imitation = train_airl(
                demonstrations,
                config,
                training_seed,
                setting.device,
                setting.event_files(directory),
                clock.watch(on_progress),
                directory.metrics,
            )
        require_normaliser(imitation.normaliser, "the imitation policy", "train AIRL longer")
        save_policy(directory.policy, imitation.policy, config.ppo.policy, world)
        save_reward(directory.path / "reward.safetensors", imitation.network, imitation.normaliser, world)
        summary = {"env_steps": imitation.env_steps, **clock.summary(), "normaliser": imitation.normaliser}
        write_json(directory.summary, summary)
    return summary

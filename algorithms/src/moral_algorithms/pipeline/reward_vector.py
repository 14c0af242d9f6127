"""The reward vector of a run: primary components with their normalisers, and copies of learned rewards."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol

from moral_algorithms.bridge import LearnedReward, PrimaryReward, RewardComponent
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners.expert import ExpertConfig, train_expert
from moral_algorithms.learners.ppo import PPOConfig, sampling_seed
from moral_algorithms.networks.files import load_reward
from moral_algorithms.pipeline.stage import Setting, StageClock, require_normaliser
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import StorageError, atomic_write, has_fields, read_json, write_json
from moral_algorithms.worlds import WorldSpec

_NORMALISER_EPISODES = 200
_REWARD = "reward.safetensors"


class RewardVector(Protocol):
    """What a run says of its reward vector."""

    @property
    def rewards(self) -> tuple[Path, ...]:
        """Run directories of AIRL, one per expert; the components are learned_1, learned_2 and so on."""

    @property
    def world(self) -> WorldSpec:
        """Where the agent acts."""

    @property
    def primary(self) -> tuple[str, ...]:
        """Components of the world's reward vector that the agent is given; they come first."""

    @property
    def normaliser(self) -> ExpertConfig:
        """How the policies are trained that pursue one primary component alone."""

    @property
    def returns(self) -> dict[str, float]:
        """Returns of such policies that are known already, by component."""


def normaliser_config(world: str = "emergency") -> ExpertConfig:
    """Find how policies that pursue one primary component alone are trained in a world.

    Until they are near the best: a component whose normaliser is too small drowns the others.
    """
    if world == "delivery":
        return ExpertConfig(
            max_steps=1_000_000, patience=1000, ppo=PPOConfig(entropy_start=0.03, entropy_end=0.01)
        )
    return ExpertConfig(max_steps=150_000, ppo=PPOConfig(entropy_start=0.01, entropy_end=0.01))


def choose_world(name: str | None, rules: dict[str, int], rewards: tuple[Path, ...]) -> WorldSpec:
    """Take the world that is given; without name and rules, that of the first reward; of none, the default.

    Raises
    ------
    ValueError
        If there is no such world, or the reward cannot be read.
    """
    if name is not None or rules:
        return WorldSpec(name or "emergency", rules)
    return load_reward(rewards[0] / _REWARD).world if rewards else WorldSpec()


def require_reward_vector(run: RewardVector) -> None:
    """Raise a ValueError if a reward vector is impossible."""
    world = run.world.build()
    most = dict(zip(world.reward_names, world.reward_bounds[1], strict=True))
    for name in run.primary:
        PrimaryReward(world.reward_names, name)
        if most[name] <= 0:
            able = [other for other, amount in most.items() if amount > 0]
            raise ValueError(f"primary is {name!r}, whose reward is never positive; it must be one of {able}")
    for name, value in run.returns.items():
        if name not in run.primary:
            raise ValueError(f"returns name {name!r}; they must be of {run.primary}, the primary components")
        require_normaliser(value, f"returns, for {name},", "give a positive one")
    if len(set(run.primary)) < len(run.primary):
        raise ValueError(f"primary is {run.primary}; it must name no component twice")
    if len(run.primary) + len(run.rewards) < 2:
        raise ValueError(
            f"rewards names {len(run.rewards)} learned and primary {len(run.primary)} given components; "
            "weights need two or more between them"
        )


def require_worlds(run: RewardVector) -> None:
    """Raise a StorageError if a reward cannot be read or was learned in another world."""
    for path in run.rewards:
        found = load_reward(path / _REWARD).world
        if found.build() != run.world.build():
            raise StorageError(f"{path} was learned in {found.to_json()}; it must be {run.world.to_json()}")


def component_names(run: RewardVector) -> tuple[str, ...]:
    """List the components of a run's reward vector: the primary ones, then learned_1 and so on."""
    return (*run.primary, *_learned_names(run))


def copy_rewards(directory: RunDirectory, run: RewardVector) -> None:
    """Copy the reward networks into a run's directory, so that it needs nothing else."""
    _copy_networks((path / _REWARD for path in run.rewards), directory, run)


def copy_reward_vector(directory: RunDirectory, source: RunDirectory, run: RewardVector) -> None:
    """Copy reward networks and known normalisers from the directory of another run with this reward vector.

    Raises
    ------
    StorageError
        If the normalisers are damaged, or something cannot be written.
    """
    _copy_networks(_copies(source, run).values(), directory, run)
    write_json(_normalisers(directory), _read_normalisers(_normalisers(source)))


def reward_components(directory: RunDirectory, run: RewardVector, device: str) -> list[RewardComponent]:
    """Make the components, normalised, from what a run's directory holds.

    Raises
    ------
    StorageError
        If normalisers or reward networks are missing or damaged.
    """
    names = run.world.build().reward_names
    normalisers = _read_normalisers(_normalisers(directory))
    if missing := set(run.primary) - normalisers.keys():
        raise StorageError(f"{_normalisers(directory)} has no normaliser of {sorted(missing)}")
    components: list[RewardComponent] = [
        PrimaryReward(names, name, 1 / normalisers[name]["return"]) for name in run.primary
    ]
    for name, copy in _copies(directory, run).items():
        network, normaliser, _ = load_reward(copy, device)
        components.append(LearnedReward(name, network, 1 / normaliser))
    return components


def total(normalisers: dict[str, dict[str, Any]], key: str) -> Any:
    """Sum up what several normalisers took."""
    return sum(entry[key] for entry in normalisers.values())


def _read_normalisers(path: Path) -> dict[str, dict[str, Any]]:
    """Read the returns of the policies that pursue one primary component alone, checked."""
    found = read_json(path) if path.exists() else {}
    types = {"return": float, "env_steps": int, "wall_seconds": float}
    entries = found.values() if isinstance(found, dict) else [found]
    for entry in entries:
        if not has_fields(entry, types):
            raise StorageError(f"{path} is damaged: it holds {entry!r}, which is no normaliser")
        require_normaliser(entry["return"], f"an entry of {path}", "remove the file")
    normalisers: dict[str, dict[str, Any]] = found
    return normalisers


def forget_normalisers(directory: RunDirectory) -> None:
    """Remove the normalisers that a run has found which another one replaces."""
    _normalisers(directory).unlink(missing_ok=True)


def primary_normalisers(
    directory: RunDirectory, run: RewardVector, seed: int, setting: Setting
) -> dict[str, dict[str, Any]]:
    """Find what a policy that pursues one primary component alone earns (eq. 5.2), once per run.

    Raises
    ------
    ValueError
        If one earns nothing. The directory holds no run then, and another can be started in it.
    """
    path = _normalisers(directory)
    found = _read_normalisers(path)
    for name, component_seed in zip(run.primary, spawn_seeds(seed, len(run.primary)), strict=True):
        if name in found:
            continue
        if name in run.returns:
            found[name] = {"return": float(run.returns[name]), "env_steps": 0, "wall_seconds": 0.0}
        else:
            try:
                found[name] = pursue_alone(run.world, name, run.normaliser, component_seed, setting)
            except ValueError:
                directory.config.unlink(missing_ok=True)
                path.unlink(missing_ok=True)
                raise
        write_json(path, found)
    return found


def pursue_alone(
    world: WorldSpec, component: str, config: ExpertConfig, seed: int, setting: Setting
) -> dict[str, Any]:
    """Find what a policy earns that pursues one component of the world's reward vector alone (eq. 5.2).

    Parameters
    ----------
    world
        Where it acts.
    component
        Name of the component.
    config
        How the policy is trained.
    seed
        Entropy of all of it.
    setting
        How the stage is run.

    Returns
    -------
    dict
        ``return``, the absolute value of its mean return, ``env_steps`` and ``wall_seconds``.

    Raises
    ------
    ValueError
        If the policy earns nothing, by which nothing can be divided.
    """
    training_seed, evaluation_seed = spawn_seeds(seed, 2)
    clock = StageClock()
    built = world.build()
    alone = [float(component == other) for other in built.reward_names]
    with setting.stage("primary") as on_progress:
        trained = train_expert(world, alone, config, training_seed, setting.device, on_progress=on_progress)
        with sampling_seed(evaluation_seed):
            played = play_episodes(trained.policy, built, _NORMALISER_EPISODES, evaluation_seed)
    column = built.reward_names.index(component)
    mean = abs(float(played.returns[:, column].mean()))
    who = f"the policy that pursues {component} alone"
    require_normaliser(mean, who, "train it longer (--normaliser.max-steps)")
    env_steps = trained.env_steps + played.actions.size
    return {"return": mean, "env_steps": env_steps, "wall_seconds": clock.seconds}


def _normalisers(directory: RunDirectory) -> Path:
    return directory.path / "normalisers.json"


def _copy_networks(paths: Iterable[Path], directory: RunDirectory, run: RewardVector) -> None:
    for path, copy in zip(paths, _copies(directory, run).values(), strict=True):
        network = path.read_bytes()
        with atomic_write(copy) as file:
            file.write(network)


def _copies(directory: RunDirectory, run: RewardVector) -> dict[str, Path]:
    """Where a run keeps its reward networks, by the names of their components."""
    return {name: directory.path / f"{name}.safetensors" for name in _learned_names(run)}


def _learned_names(run: RewardVector) -> list[str]:
    return [f"learned_{number}" for number in range(1, len(run.rewards) + 1)]

"""Seeds as Gymnasium has them: of any integer type, and told afterwards where none was given."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from moral_envs import delivery_v0, emergency_v0, noisy_constraint_v0, windy_wall_v0

MODULES = [emergency_v0, delivery_v0, windy_wall_v0, noisy_constraint_v0]
each_module = pytest.mark.parametrize(
    "module", MODULES, ids=lambda module: module.__name__.rpartition(".")[2]
)


def rules(module: Any) -> dict[str, Any]:
    return {"noise": 1.0} if module is noisy_constraint_v0 else {}


def trace(env: Any, seed: Any = None) -> list[Any]:
    """What a reset and a few steps show, of the single or the vector face."""
    observation, _ = env.reset(seed=seed)
    found = [observation]
    for _ in range(1 if "noisy" in type(env).__module__ else 5):
        action = np.zeros(env.num_envs, dtype=np.int64) if hasattr(env, "num_envs") else 0
        observation, reward, *_ = env.step(action)
        found += [observation, reward]
    return found


def same(one: list[Any], other: list[Any]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@each_module
def test_an_episode_without_a_seed_is_played_again_by_the_seed_that_is_told(module: Any) -> None:
    env = module.single_env(**rules(module))
    found = trace(env)
    assert same(found, trace(env, env.np_random_seed))
    assert same(found, trace(module.single_env(**rules(module)), env.np_random_seed))
    assert not same(found, trace(env, env.np_random_seed + 1)) or module is windy_wall_v0


@each_module
def test_the_seed_that_was_given_is_told(module: Any) -> None:
    env = module.single_env(**rules(module))
    env.reset(seed=7)
    assert env.np_random_seed == 7
    envs = module.vector_env(3, **rules(module))
    envs.reset(seed=8)
    assert envs.np_random_seed == 8


@each_module
def test_a_batch_without_a_seed_is_played_again_by_the_seed_that_is_told(module: Any) -> None:
    envs = module.vector_env(3, **rules(module))
    found = trace(envs)
    assert same(found, trace(envs, envs.np_random_seed))


@each_module
def test_a_generator_of_ones_own_changes_nothing(module: Any) -> None:
    env = module.single_env(**rules(module))
    env.np_random = np.random.default_rng(0)
    trace(env)
    assert same(trace(env, 3), trace(module.single_env(**rules(module)), 3))


@each_module
def test_copies_of_what_was_never_seeded_go_their_own_ways(module: Any) -> None:
    for face in (module.single_env, module.vector_env):
        # The wind alone is no more than a chance that they differ.
        if module is not windy_wall_v0:
            one = face(**rules(module))
            other = copy.deepcopy(one)
            assert not same(trace(one), trace(other))


@each_module
@pytest.mark.parametrize("face", ["single_env", "parallel_env", "env", "vector_env"])
def test_any_integer_is_a_seed(module: Any, face: str) -> None:
    env = getattr(module, face)(**rules(module))
    for seed in np.arange(3):
        env.reset(seed=seed)
    env.reset(seed=np.uint8(3))
    if face == "vector_env":
        env.reset(seed=np.arange(1))


@each_module
@pytest.mark.parametrize("seed", [True, 1.5, "1", -1, {1}, {0: 1}, [1, 2, 3], [0.5, 1]])
def test_anything_else_is_refused(module: Any, seed: Any) -> None:
    envs = module.vector_env(2, **rules(module))
    with pytest.raises(ValueError, match=r"^seed "):
        envs.reset(seed=seed)
    if not isinstance(seed, (list, dict, set)):
        for face in (module.single_env, module.parallel_env, module.env):
            with pytest.raises(ValueError, match=r"^seed is "):
                face(**rules(module)).reset(seed=seed)


@each_module
def test_options_of_a_batch_are_a_dict(module: Any) -> None:
    with pytest.raises(ValueError, match=r"^options is 5; it must be a dict or None$"):
        module.vector_env(2, **rules(module)).reset(options=5)

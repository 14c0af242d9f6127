"""What holds in every world at every step, whoever acts how: over 50,000 random steps in every run."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_envs.engine import Engine, Step
from moral_envs.streams import spawn_streams
from moral_envs.world import NUM_ACTIONS, NUM_MOVES, Effect, World
from tests.envs.worlds import agent_rewards, package_worlds, seeds, small_worlds

EXAMPLES, STEPS = 100, 512
"""Random engines, and the environment steps that each takes at least: 51,200 in all."""

TOLERANCE = 1e-4
"""Rewards are float32: far above their rounding, far below what a single event pays."""

MOVES = np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])
INTERACTIONS = {NUM_ACTIONS - NUM_MOVES + way: MOVES[way] for way in range(NUM_MOVES)}


def itemised(world: World) -> World:
    """The same rules, but each effect moves a component and a counter that no other effect moves."""
    names: list[str] = []

    def own(effect: Effect | None) -> Effect | None:
        if effect is None:
            return None
        names.append(f"effect {len(names)}")
        return Effect(names[-1], effect.amount or 1.0, names[-1])

    kinds = [
        replace(kind, on_interact=own(kind.on_interact), on_enter=own(kind.on_enter))
        for kind in world.objects
    ]
    fixture = world.fixture and replace(world.fixture, on_stand=own(world.fixture.on_stand))
    on_step = own(world.on_step)
    # A world needs at least one of each.
    listed = tuple(names) or ("nothing",)
    rules: dict[str, Any] = {"objects": tuple(kinds), "fixture": fixture, "on_step": on_step}
    return replace(world, reward_names=listed, objective_names=listed, **rules)


@st.composite
def itemised_engines(draw: st.DrawFn) -> Engine:
    num_agents = draw(st.integers(1, 5))
    world = itemised(draw(small_worlds(num_agents) | package_worlds))
    engine = Engine(
        world,
        draw(st.sampled_from([16, 32])),
        num_agents,
        draw(st.booleans()),
        draw(st.none() | st.integers(1, 3)),
        draw(st.none() | agent_rewards(world, num_agents)),
    )
    engine.seed(spawn_streams(draw(seeds), engine.num_envs))
    engine.reset()
    return engine


@dataclass
class View:
    """A moment in all environments; cells are pairs of row and column."""

    walls: NDArray[np.bool_]
    """Shape (n_envs, H, W)."""
    kinds: NDArray[np.bool_]
    """Where there are objects of each kind, shape (n_envs, kinds, H, W)."""
    agents: NDArray[np.int64]
    """Shape (n_envs, n_agents, 2)."""
    walkers: NDArray[np.int64]
    """Cells of the objects that walk, shape (n_envs, walkers, 2)."""
    walking: NDArray[np.bool_]
    """Which of them are still there, shape (n_envs, walkers)."""
    fixture: NDArray[np.bool_]
    """Shape (n_envs, H, W)."""
    counters: NDArray[np.int64]
    elapsed: NDArray[np.int64]

    @classmethod
    def of(cls, engine: Engine) -> View:
        planes, state, num_kinds = engine.world_planes() > 0, engine.state_dict(), len(engine.world.objects)
        nobody = np.zeros((0, engine.num_envs), dtype=np.int64)
        walkers = np.divmod(state.get("walker_cells", nobody).T, engine.world.width)
        fixture = planes[:, -1] if engine.world.fixture is not None else np.zeros_like(planes[:, 0])
        return cls(
            walls=planes[:, 0],
            kinds=planes[:, 2 : 2 + num_kinds],
            agents=engine.agent_cells,
            walkers=np.stack(walkers, axis=-1),
            walking=state.get("walking", nobody.astype(np.bool_)).T,
            fixture=fixture,
            counters=engine.objectives,
            elapsed=engine.elapsed,
        )

    @property
    def numbers(self) -> NDArray[np.int64]:
        """How many objects of each kind there are, shape (n_envs, kinds)."""
        return self.kinds.sum(axis=(2, 3))

    def at(self, planes: NDArray[Any], cells: NDArray[np.int64]) -> NDArray[Any]:
        """Look up cells (n_envs, x, 2) in planes (n_envs, ..., H, W): an array (n_envs, x, ...)."""
        rows, columns = np.moveaxis(cells, -1, 0)
        return planes[np.arange(len(planes))[:, None], ..., rows, columns]


def walking_kinds(world: World) -> NDArray[np.int64]:
    """The kind of each object that walks."""
    kinds = enumerate(world.objects)
    return np.array(
        [number for number, kind in kinds for _ in range(kind.count) if kind.walks > 0], dtype=int
    )


def require_a_possible_state(world: World, view: View) -> None:
    """Nothing is in a wall or where something else is that would block it."""
    assert view.walls[:, [0, -1]].all()
    assert view.walls[:, :, [0, -1]].all()
    for cells in view.agents:
        assert len({tuple(cell) for cell in cells.tolist()}) == len(cells)
    assert not view.at(view.walls, view.agents).any()
    objects = view.kinds.sum(axis=1)
    assert (objects <= 1).all()
    assert not (objects * view.walls).any()
    assert not (view.fixture & view.walls).any()
    assert (view.fixture.sum(axis=(1, 2)) == (world.fixture is not None)).all()
    # An object that walks is where the planes show one of its kind, and every such place is one's.
    kinds = walking_kinds(world)
    shown = np.zeros_like(view.kinds, dtype=int)
    envs, walkers = np.nonzero(view.walking)
    rows, columns = view.walkers[envs, walkers].T
    np.add.at(shown, (envs, kinds[walkers], rows, columns), 1)
    walks = [kind.walks > 0 for kind in world.objects]
    assert np.array_equal(shown[:, walks], view.kinds[:, walks])


def require_a_start(world: World, view: View, chosen: NDArray[np.bool_]) -> None:
    """The chosen environments are at the start of an episode."""
    require_a_possible_state(world, view)
    assert not view.elapsed[chosen].any()
    assert not view.counters[chosen].any()
    if world.layout is None:
        counts = [kind.count for kind in world.objects]
        assert np.array_equal(view.numbers[chosen], np.tile(counts, (chosen.sum(), 1)))
    if world.fixture is not None and world.fixture.terminates:
        assert not view.at(view.fixture, view.agents)[chosen].any()
    on_objects = view.at(view.kinds, view.agents)[chosen]
    assert not on_objects.any()


def require_a_lawful_step(
    engine: Engine, before: View, actions: NDArray[np.int64], step: Step, after: View
) -> None:
    """One step of all environments, none of which restarted."""
    world, num_agents = engine.world, engine.num_agents
    require_a_possible_state(world, after)
    assert np.array_equal(after.walls, before.walls)
    assert np.array_equal(after.fixture, before.fixture)

    ways = after.agents - before.agents
    moved = np.abs(ways).sum(axis=2)
    assert (moved <= 1).all()
    if world.slip == 0:
        for action in range(world.num_actions):
            taken = ways[(actions == action) & (moved > 0)]
            assert action < NUM_MOVES or len(taken) == 0
            assert action >= NUM_MOVES or (taken == MOVES[action]).all()

    # Objects that walk go one cell at most, and those that do not stay where they are.
    walks = np.array([kind.walks > 0 for kind in world.objects], dtype=bool)
    assert (after.kinds <= before.kinds)[:, ~walks].all()
    assert (after.walking <= before.walking).all()
    distances = np.abs(after.walkers - before.walkers).sum(axis=2)
    assert (distances <= 1).all()
    assert not distances[~after.walking].any()

    # What has happened to each agent: the counters alone tell, one for each effect.
    counted = after.counters - before.counters
    assert (counted >= 0).all()
    if engine.team_reward:
        assert (counted == counted[:, :1]).all()
    in_all = counted[:, 0] if engine.team_reward else counted.sum(axis=1)

    def count(effect: Effect | None) -> NDArray[np.int64]:
        nothing = np.zeros(engine.num_envs, dtype=np.int64)
        return nothing if effect is None else in_all[:, world.objective_names.index(effect.objective)]

    standing = after.at(after.fixture, after.agents)
    at_the_end = world.fixture is not None and world.fixture.terminates
    if world.fixture is not None:
        assert np.array_equal(count(world.fixture.on_stand), standing.sum(axis=1))
    if world.on_step is not None:
        assert np.array_equal(count(world.on_step), num_agents - at_the_end * standing.sum(axis=1))

    entered = before.at(before.kinds, after.agents) & (moved > 0)[..., None]
    touched = np.zeros_like(entered)
    for action, way in INTERACTIONS.items():
        touched |= (
            before.at(before.kinds, before.agents + way) & ((actions == action) & (moved == 0))[..., None]
        )
    for number, kind in enumerate(world.objects):
        gone = before.numbers[:, number] - after.numbers[:, number]
        assert np.array_equal(gone, count(kind.on_enter) + count(kind.on_interact))
        # A kind disappears from where an agent went or reached out to, if that is its rule.
        assert (count(kind.on_enter) <= entered[:, :, number].sum(axis=1)).all()
        assert (count(kind.on_interact) <= touched[:, :, number].sum(axis=1)).all()
        if kind.on_enter is not None:
            assert not (after.at(after.kinds[:, number], after.agents) & (moved > 0)).any()
        if kind.on_enter is not None or (kind.on_interact is not None and world.slip == 0):
            due = entered[:, :, number] * (kind.on_enter is not None)
            if kind.on_interact is not None and world.slip == 0:
                due = due | touched[:, :, number]
            assert (gone >= due.any(axis=1)).all()
        # An object without a walk that disappeared was one that an agent entered or touched.
        lost = before.kinds[:, number] & ~after.kinds[:, number]
        if kind.walks == 0:
            explained = np.zeros_like(lost)
            for env, agent in np.argwhere(entered[:, :, number] * (kind.on_enter is not None)):
                explained[(env, *after.agents[env, agent])] = True
            for env, agent in np.argwhere(touched[:, :, number] * (kind.on_interact is not None)):
                explained[(env, *(before.agents[env, agent] + INTERACTIONS[int(actions[env, agent])]))] = True
            assert not (lost & ~explained).any()

    # Each agent is paid what was counted, times what one such event pays, if it is paid for it at all.
    amounts = np.zeros(len(world.reward_names))
    for effect in world.effects:
        amounts[world.reward_names.index(effect.reward)] = effect.amount
    paid = 1 if engine.agent_rewards is None else engine.agent_rewards
    assert (abs(step.rewards - counted * amounts * paid) <= TOLERANCE).all()

    assert np.array_equal(after.elapsed, before.elapsed + 1)
    ends = standing.any(axis=1) if at_the_end else np.zeros(engine.num_envs, dtype=np.bool_)
    assert np.array_equal(step.terminations, ends)
    assert np.array_equal(step.truncations, (after.elapsed >= engine.horizons) & ~ends)
    assert step.any_end == (step.terminations | step.truncations).any()


def by_environment(engine: Engine) -> dict[str, NDArray[Any]]:
    """Everything there is to know, with the environments on the first axis."""
    state: dict[str, NDArray[Any]] = {**engine.state_dict(), "horizons": engine.horizons}
    state["planes"] = state["planes"].reshape(engine.num_envs, -1)
    for name in ("walker_cells", "walking"):
        if name in state:
            state[name] = state[name].T
    return {
        **state,
        "observations": engine.observe(),
        "world": engine.world_planes(),
        "objectives": engine.objectives,
        "agent_cells": engine.agent_cells,
    }


def require_same(left: Engine, right: Engine, chosen: NDArray[np.bool_]) -> None:
    """The chosen environments are the same in two engines."""
    ours, theirs = by_environment(left), by_environment(right)
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        assert np.array_equal(array[chosen], theirs[name][chosen]), name


def require_restarts_of_their_own(
    engine: Engine, twins: tuple[Engine, Engine], actions: NDArray[np.int64], restart: NDArray[np.bool_]
) -> None:
    """A step in which some restart is a step for the others and a reset for them, as twins take them."""
    stepped, reset = twins
    for twin in twins:
        twin.load_state_dict(engine.state_dict())
    step = engine.step(actions, restart)
    expected = stepped.step(actions)
    reset.reset(restart)
    require_same(engine, stepped, ~restart)
    require_same(engine, reset, restart)
    for ours, theirs in zip(step[:3], expected[:3], strict=True):
        assert np.array_equal(ours[~restart], theirs[~restart])
        assert not ours[restart].any()
    assert step.any_end == (step.terminations | step.truncations).any()


def take_random_steps(engine: Engine, rng: np.random.Generator) -> int:
    """Check random steps with resets in between; returns how many environment steps it were."""
    everywhere = np.ones(engine.num_envs, dtype=np.bool_)
    twins = copy.deepcopy(engine), copy.deepcopy(engine)
    view = View.of(engine)
    require_a_start(engine.world, view, everywhere)
    totals = np.zeros(view.counters.shape)
    units = np.array([effect.amount for effect in engine.world.effects] or [1.0])
    paid = everywhere[:, None, None] if engine.agent_rewards is None else engine.agent_rewards > 0
    ended = ~everywhere
    steps = 0
    while steps < STEPS:
        # Some environments restart before their time, some go on beyond it.
        restart = rng.random(engine.num_envs) < np.where(ended, 0.7, 0.02)
        actions = rng.integers(engine.world.num_actions, size=(engine.num_envs, engine.num_agents))
        if restart.any() and rng.random() < 0.5:
            require_restarts_of_their_own(engine, twins, actions, restart)
            view = View.of(engine)
            require_a_start(engine.world, view, restart)
            ended = engine.elapsed >= engine.horizons
            totals = view.counters * units
            continue
        if restart.any():
            twins[0].load_state_dict(engine.state_dict())
            engine.reset(restart)
            require_same(engine, twins[0], ~restart)
            assert (engine.streams != twins[0].streams)[restart].all()
            view = View.of(engine)
            require_a_start(engine.world, view, restart)
            totals[restart] = 0
        step = engine.step(actions)
        steps += engine.num_envs
        after = View.of(engine)
        require_a_lawful_step(engine, view, actions, step, after)
        view, ended = after, step.terminations | step.truncations
        totals += step.rewards
        assert (abs(totals / units - after.counters) * paid <= TOLERANCE).all()
    return steps


def test_the_invariants_hold_over_fifty_thousand_random_steps() -> None:
    """One environment's step counts as one, however many agents take it; restarts do not count."""
    taken = []

    @settings(
        max_examples=EXAMPLES,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(engine=itemised_engines(), seed=seeds)
    def hold(engine: Engine, seed: int) -> None:
        taken.append(take_random_steps(engine, np.random.default_rng(seed)))

    hold()
    assert sum(taken) >= 50_000

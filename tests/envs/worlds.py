"""Random worlds and engines, for the property tests."""

from __future__ import annotations

from hypothesis import strategies as st

from moral_envs import delivery_v0, emergency_v0
from moral_envs.engine import Engine
from moral_envs.streams import spawn_streams
from moral_envs.world import Effect, Fixture, ObjectKind, World

REWARDS = ("first", "second", "third")
OBJECTIVES = ("one", "two")

seeds = st.integers(0, 2**32 - 1)

# Quarters, so that sums are exact in whatever order they are taken.
effects = st.builds(
    Effect,
    reward=st.sampled_from(REWARDS),
    amount=st.integers(-8, 8).map(lambda quarters: quarters / 4),
    objective=st.sampled_from(OBJECTIVES),
)


@st.composite
def custom_worlds(draw: st.DrawFn, max_agents: int) -> World:
    """Worlds of any rules that leave room for the agents."""
    height, width = draw(st.integers(3, 7)), draw(st.integers(3, 8))
    while (height - 2) * (width - 2) < max_agents:
        width += 1
    room = (height - 2) * (width - 2) - max_agents
    kinds = []
    for number in range(draw(st.integers(0, 4))):
        count = draw(st.integers(0, min(room, 6)))
        room -= count
        on_interact, on_enter = draw(st.none() | effects), draw(st.none() | effects)
        kinds.append(ObjectKind(f"kind{number}", count, "box", "x", on_interact, on_enter))
    fixture = draw(st.none() | effects.map(lambda effect: Fixture("fixture", "extinguisher", "E", effect)))
    return World(
        name="custom",
        height=height,
        width=width,
        horizon=draw(st.integers(1, 9)),
        reward_names=REWARDS,
        objective_names=OBJECTIVES,
        objects=tuple(kinds),
        fixture=fixture,
    )


@st.composite
def small_worlds(draw: st.DrawFn, max_agents: int) -> World:
    """Small variants of the two worlds, and worlds of other rules."""
    horizon = draw(st.integers(1, 9))
    height, width = draw(st.integers(5, 7)), draw(st.integers(5, 7))
    emergency = emergency_v0.world(height, width, draw(st.integers(0, 9 - max_agents)), horizon)
    counts = [draw(st.integers(0, 2)) for _ in range(4)]
    delivery = delivery_v0.world(height + 1, width + 1, *counts, max_cycles=horizon)
    return draw(st.sampled_from([emergency, delivery]) | custom_worlds(max_agents))


@st.composite
def engines(draw: st.DrawFn, max_envs: int = 4, max_agents: int = 4) -> Engine:
    """Seeded engines of small worlds, at the start of an episode."""
    num_agents = draw(st.integers(1, max_agents))
    world = draw(small_worlds(num_agents))
    engine = Engine(world, draw(st.integers(1, max_envs)), num_agents, draw(st.booleans()))
    engine.seed(spawn_streams(draw(seeds), engine.num_envs))
    engine.reset()
    return engine

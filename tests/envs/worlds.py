"""Random worlds and engines, for the property tests."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import strategies as st

from moral_envs import burning_warehouse_v0, delivery_v0, emergency_v0, windy_wall_v0
from moral_envs.engine import Engine
from moral_envs.layouts import Layout
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

chances = st.sampled_from([0.0, 0.25, 1.0])


@st.composite
def custom_worlds(draw: st.DrawFn, max_agents: int, random: bool) -> World:
    """Worlds of any rules with room for the agents; without chance after the start unless ``random``."""
    height, width = draw(st.integers(3, 7)), draw(st.integers(3, 8))
    # The cell of a fixture that terminates is nobody's start.
    while (height - 2) * (width - 2) < max_agents + 1:
        width += 1
    cells = [(row, column) for row in range(1, height - 1) for column in range(1, width - 1)]
    walls = draw(st.lists(st.sampled_from(cells), max_size=len(cells) - max_agents - 1, unique=True))
    room = len(cells) - len(walls) - max_agents - 1
    num_actions = draw(st.sampled_from([4, 5, 9]))
    interactions = st.none() | effects if num_actions == 9 else st.none()
    kinds = []
    for number in range(draw(st.integers(0, 4))):
        count = draw(st.integers(0, min(room, 6)))
        room -= count
        on_interact, on_enter = draw(interactions), draw(st.none() | effects)
        walks = draw(chances) if random else 0.0
        kinds.append(ObjectKind(f"kind{number}", count, "box", "wxyz"[number], on_interact, on_enter, walks))
    free = st.sampled_from(sorted({*cells} - {*walls}))
    fixtures = st.builds(
        lambda effect, cell, ends: Fixture("fixture", "extinguisher", "E", effect, cell, ends),
        effects,
        st.none() | free,
        st.booleans(),
    )
    return World(
        name="custom",
        height=height,
        width=width,
        horizon=draw(st.integers(1, 9)),
        reward_names=REWARDS,
        objective_names=OBJECTIVES,
        objects=tuple(kinds),
        fixture=draw(st.none() | fixtures),
        interior_walls=tuple(walls),
        start=draw(st.sampled_from(["random", "corner"])),
        slip=draw(chances) if random else 0.0,
        on_step=draw(st.none() | effects),
        num_actions=num_actions,
    )


@st.composite
def drawn_worlds(draw: st.DrawFn, max_agents: int, random: bool) -> World:
    """Burning Warehouse and Delivery in small rooms that are drawn for every episode."""
    sizes = st.tuples(st.integers(6, 7), st.integers(8, 9))
    layout = Layout(
        height=draw(sizes),
        width=draw(sizes),
        walls=draw(st.sampled_from([0.0, (0.2, 0.8), 1.0])),
        counts={"people": draw(st.sampled_from([0, 1, (0, 3)]))},
        max_cycles=draw(st.sampled_from([3, (1, 9)])),
    )
    if draw(st.booleans()):
        return delivery_v0.world(
            num_deliveries=1, num_pollution=1, num_vases=max(0, 6 - max_agents), layout=layout
        )
    world = burning_warehouse_v0.world(walk=draw(chances) if random else 0.0, layout=layout)
    assert world.fixture is not None
    return replace(world, fixture=replace(world.fixture, terminates=draw(st.booleans())))


@st.composite
def small_worlds(draw: st.DrawFn, max_agents: int, random: bool = True) -> World:
    """Small variants of the package's worlds, and worlds of other rules."""
    horizon = draw(st.integers(1, 9))
    height, width = draw(st.integers(5, 7)), draw(st.integers(5, 7))
    emergency = emergency_v0.world(height, width, draw(st.integers(0, 9 - max_agents)), horizon)
    counts = [draw(st.integers(0, 2)) for _ in range(4)]
    delivery = delivery_v0.world(height + 1, width + 1, *counts, max_cycles=horizon)
    own = [emergency, delivery, windy_wall_v0.world(0.25 if random else 0.0, horizon)]
    return draw(st.sampled_from(own) | custom_worlds(max_agents, random) | drawn_worlds(max_agents, random))


def agent_rewards(world: World, num_agents: int) -> st.SearchStrategy[list[list[str]]]:
    """Some reward components for each agent."""
    names = st.lists(st.sampled_from(world.reward_names), min_size=1, unique=True)
    return st.lists(names, min_size=num_agents, max_size=num_agents)


PACKAGE_WORLDS = [
    emergency_v0.world(),
    emergency_v0.world(pickup="enter", walk=0.5),
    delivery_v0.world(),
    burning_warehouse_v0.world(),
    windy_wall_v0.world(),
    *(
        module.world(layout=layout)
        for module in (emergency_v0, delivery_v0, burning_warehouse_v0)
        for layout in ("random", "maze", "ring")
    ),
]

package_worlds = st.sampled_from(PACKAGE_WORLDS)
"""The package's worlds in their own sizes."""


@st.composite
def engines(draw: st.DrawFn, max_envs: int = 4, max_agents: int = 4) -> Engine:
    """Seeded engines of small worlds, at the start of an episode."""
    num_agents = draw(st.integers(1, max_agents))
    world = draw(small_worlds(num_agents))
    engine = Engine(
        world,
        draw(st.integers(1, max_envs)),
        num_agents,
        draw(st.booleans()),
        draw(st.sampled_from([None, None, 1, 2, 5])),
        draw(st.none() | agent_rewards(world, num_agents)),
    )
    engine.seed(spawn_streams(draw(seeds), engine.num_envs))
    engine.reset()
    return engine

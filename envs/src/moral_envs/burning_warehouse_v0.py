"""Burning Warehouse: pick up lost workers who wander about, or stand by the extinguisher and let it pay.

## Description
Workers are lost in a burning warehouse and wander about. The agent picks one up by moving onto its cell, or
stays at the fire extinguisher, which pays on every step spent on its cell. These are the rules of
`emergency_v0` with other settings: there people stay where they are and are saved from a neighbouring cell.

    ########################
    ### .  P  .  .  .  . ###
    ### P  .  .  .  .  . ###
    ### .  . A   .  P  . ###
    ### P  .  .  .  .  . ###
    ### .  .  P  .  .  P ###
    ### .  .  .  .  .   E###
    ########################

The frame is `single_env(render_mode="ansi")` after `reset(seed=2)`: `A` is the agent, `P` a person, `E`
the extinguisher, `#` a wall. A cell shows agent, person and extinguisher in this order.

## Observation Space
A `uint8` array of shape `(4, height, width)`, 1 where there is something and 0 elsewhere, in four planes:
walls, the agent, people, the extinguisher. With several agents a fifth plane shows the other agents.

## Action Space
`Discrete(9)` for each agent, as in every world with objects, though interacting does nothing here:

- 0, 1, 2, 3: move up, down, left, right, which saves a person on the cell: the person leaves the grid. Walls
  and other agents block.
- 4: wait.
- 5, 6, 7, 8: interact with the neighbouring cell up, down, left, right, to no effect.

## Reward Space
A `float32` array of shape `(2,)`, named by `reward_names`:

- `extinguish`: 0.1 on every step that ends on the extinguisher's cell, whatever the action was.
- `save`: 1 for every person saved.

`info["objectives"]`, `int64` of shape `(2,)` and named by `objective_names`, counts the same events over
the episode so far: `goal_time`, the steps on the extinguisher's cell, and `people_saved`.

## Starting State
The agents and the people are on distinct free cells, drawn uniformly. The extinguisher is always on the
bottom right free cell; a person or an agent may start there, too.

## Transitions
Once the agents have acted, every person tries, with probability `walk`, to move in a direction drawn
uniformly; people move one after the other, and walls, agents and other people block. A person never walks
onto an agent, so only the agent's own moves pick people up. All draws come from the environment's own stream:
the same seed and actions give the same episode.

## Episode Truncation
After `max_cycles` steps. No state is terminal.

## Several Agents
`parallel_env` and `env` take up to 16 agents, `agent_0`, `agent_1`, ... They act one after the other
within a step. Who is first rotates by one at every step; the order runs upwards in the agents' numbers for
as many steps as there are agents, then downwards for as many, and so on, from a start that is drawn at
reset. So each of any two agents precedes the other equally often. A move onto another agent's cell becomes
waiting; of two agents that want the same cell or object, the one earlier in the order gets it. Each agent
is paid and counted for what it does itself; with `team_reward=True` all are paid and counted for what they
do together. `agent_rewards` names, for each agent, the reward components that it is paid: their reward
vectors have these alone (in `vector_env` the others are zero).

## Arguments
All faces take:

- `height`, `width` (default 8): size in cells, the border wall included.
- `num_people` (default 6): people at the start of an episode.
- `max_cycles` (default 100): steps of an episode.
- `pickup` (default `"enter"`) and `walk` (default 1): as in `emergency_v0`.
- `layout` (default `None`): draws rooms anew for each episode, or a floor plan, by name or as a
  `moral_envs.layouts.Layout`.
- `view_radius` (default `None`): how many cells an agent sees in each direction; observations then have
  height and width `2 * view_radius + 1`, with the agent in the middle and walls beyond the border.
- `render_mode`: `None`, `"ansi"`, `"rgb_array"` or, except for `vector_env`, `"human"`.

`parallel_env` (PettingZoo's parallel interface), `env` (its agent-environment cycle) and `vector_env` also
take:

- `num_agents` (default 1), `team_reward` (default `False`) and `agent_rewards` (default `None`): see Several
  Agents.

`single_env` is Gymnasium's interface for one agent, also `gymnasium.make("moral/BurningWarehouse-v0")`.
`vector_env` is its vector interface, also `gymnasium.make_vec("moral/BurningWarehouse-v0", num_envs=...)`.
It takes:

- `num_envs` (default 1): environments in the batch.
- `num_agents` (default `None`): with a number, actions, observations, rewards and objectives get an axis of
  agents after that of environments.
- `autoreset_mode` (default `AutoresetMode.NEXT_STEP`): when an environment whose episode has ended is
  reset.

## Version History
- v0: first version.

## Credits
The world of the first paper in part II of "Training for implicit norms in deep reinforcement learning
agents through adversarial multi-objective reward optimization" (Peschl, AIES 2021), which gives the rules but
neither the size nor the number of people: those defaults are Emergency's.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from moral_envs import emergency_v0
from moral_envs.faces import Faces
from moral_envs.layouts import Layout
from moral_envs.world import World

__all__ = ["env", "parallel_env", "single_env", "vector_env", "world"]


def world(
    height: int = 8,
    width: int = 8,
    num_people: int = 6,
    max_cycles: int = 100,
    pickup: Literal["interact", "enter"] = "enter",
    walk: float = 1.0,
    layout: Layout | str | None = None,
) -> World:
    """Burning Warehouse's rules as data: :func:`moral_envs.emergency_v0.world` with other defaults.

    Parameters
    ----------
    height, width
        Size in cells, the border wall included.
    num_people
        People at the start of an episode.
    max_cycles
        Steps after which an episode truncates.
    pickup
        How people are saved: by interacting with their cell, or by moving onto it.
    walk
        Chance, at every step, that a person moves in a random direction.
    layout
        See :meth:`~moral_envs.world.World.in_layout`.
    """
    rules = emergency_v0.world(height, width, num_people, max_cycles, pickup, walk, layout)
    return replace(rules, name="burning_warehouse_v0")


_faces = Faces(world)
parallel_env, env = _faces.parallel_env, _faces.env
single_env, vector_env = _faces.single_env, _faces.vector_env

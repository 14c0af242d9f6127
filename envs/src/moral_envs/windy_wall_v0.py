"""Windy Wall: find the way around a wall to the goal while the wind blows.

## Description
The agent starts in the top left corner and has to walk around a wall to a goal on its other side. The wind
sends it in a random direction in a quarter of the steps. It is the one grid world of this package
that terminates, and it has a single reward component: a small world for tabular methods and for tests.

    ####################################
    ###A   .  .  . ### .  .  .  .   G###
    ### .  .  .  . ### .  .  .  .  . ###
    ### .  .  .  . ### .  .  .  .  . ###
    ### .  .  .  . ### .  .  .  .  . ###
    ### .  .  .  .  .  .  .  .  .  . ###
    ### .  .  .  .  .  .  .  .  .  . ###
    ####################################

The frame is `single_env(render_mode="ansi")` after `reset()`: `A` is the agent, `G` the goal, `#` a wall.

## Observation Space
A `uint8` array of shape `(3, 8, 12)`, 1 where there is something and 0 elsewhere, in three planes: walls,
the agent, the goal. With several agents a fourth plane shows the other agents.

## Action Space
`Discrete(4)` for each agent: move up, down, left, right. Walls and other agents block.

## Reward Space
A `float32` array of shape `(1,)`, named by `reward_names`:

- `time`: -1 on every step that does not end on the goal, 0 on the step that does.

`info["objectives"]`, `int64` of shape `(2,)` and named by `objective_names`, counts over the episode so far:
`steps`, those that did not end on the goal, and `goals_reached`.

## Starting State
Always the same: the agent on the top left free cell. Several agents start on the first free cells but the
goal, row by row from there: four before the wall, and from the fifth on beyond it.

## Transitions
With probability `wind` an action is replaced by a move in a direction drawn uniformly among the four, so
the intended one is taken with probability `1 - 3/4 * wind`. The draws come from the environment's own stream.

## Episode End
The episode terminates when an agent reaches the goal, for all agents. It truncates after `max_cycles` steps.

## Several Agents
They act one after the other, as in `emergency_v0`; each is paid for its own steps, so those who have not
reached the goal pay for the last step, too.

## Arguments
All faces take:

- `wind` (default 0.25): probability that an action is replaced by a random move.
- `max_cycles` (default 1000): steps after which an episode truncates.
- `view_radius` (default `None`): how many cells an agent sees in each direction; observations then have
  height and width `2 * view_radius + 1`, with the agent in the middle and walls beyond the border.
- `render_mode`: `None`, `"ansi"`, `"rgb_array"` or, except for `vector_env`, `"human"`.

`parallel_env` (PettingZoo's parallel interface), `env` (its agent-environment cycle) and `vector_env` also
take:

- `num_agents` (default 1), `team_reward` (default `False`) and `agent_rewards` (default `None`): see Several
  Agents.

`single_env` is Gymnasium's interface for one agent, also `gymnasium.make("moral/WindyWall-v0")`. `vector_env`
is its vector interface, also `gymnasium.make_vec("moral/WindyWall-v0", num_envs=...)`. It takes:

- `num_envs` (default 1): environments in the batch.
- `num_agents` (default `None`): with a number, actions, observations, rewards and objectives get an axis of
  agents after that of environments.
- `autoreset_mode` (default `AutoresetMode.NEXT_STEP`): when an environment whose episode has ended is
  reset.

## Version History
- v0: first version.

## Credits
The example of section 2.1.3 of the thesis "Aligning AI with human norms: multi-objective deep reinforcement
learning with active preference elicitation" (Peschl, TU Delft 2021). It gives the 6 x 10 free cells, the
start, the wind and the rewards; where the wall and the goal are is this package's reading of its figure 2.2.
It names no horizon.
"""

from __future__ import annotations

from moral_envs.arguments import is_chance
from moral_envs.faces import Faces
from moral_envs.world import NUM_MOVES, Effect, Fixture, World

__all__ = ["env", "parallel_env", "single_env", "vector_env", "world"]

_WALL_COLUMN, _WALL_ROWS = 5, range(1, 5)
_GOAL = (1, 10)


def world(wind: float = 0.25, max_cycles: int = 1000) -> World:
    """Windy Wall's rules as data.

    Parameters
    ----------
    wind
        Probability that an action is replaced by a move in a random direction.
    max_cycles
        Steps after which an episode truncates.
    """
    if not is_chance(wind):
        raise ValueError(f"wind is {wind!r}; a chance is 0 to 1")
    return World(
        name="windy_wall_v0",
        height=8,
        width=12,
        horizon=max_cycles,
        reward_names=("time",),
        objective_names=("steps", "goals_reached"),
        objects=(),
        fixture=Fixture("goal", "goal", "G", Effect("time", 0.0, "goals_reached"), _GOAL, terminates=True),
        interior_walls=tuple((row, _WALL_COLUMN) for row in _WALL_ROWS),
        start="corner",
        slip=wind,
        on_step=Effect("time", -1.0, "steps"),
        num_actions=NUM_MOVES,
    )


_faces = Faces(world)
parallel_env, env = _faces.parallel_env, _faces.env
single_env, vector_env = _faces.single_env, _faces.vector_env

"""What a world's module offers: a function for each of the standard interfaces."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from inspect import Parameter, Signature
from typing import Any, Generic, TypeVar, cast, overload

from gymnasium.vector import AutoresetMode

from moral_envs.faces.aec import GridAECEnv
from moral_envs.faces.common import RENDER_FPS, RENDER_MODES
from moral_envs.faces.parallel import GridParallelEnv
from moral_envs.faces.single import GridEnv
from moral_envs.faces.vector import GridVectorEnv
from moral_envs.world import World

SingleT = TypeVar("SingleT", bound=GridEnv)

_Function = TypeVar("_Function", bound=Callable[..., Any])


class Faces(Generic[SingleT]):
    """The interfaces of one world; a module binds these functions to its own names.

    Parameters
    ----------
    world
        Makes the world from its rules, which every function takes as further keyword arguments.
    single
        Class of the Gymnasium environment.

    Attributes
    ----------
    parallel_env
        Makes a :class:`~moral_envs.faces.GridParallelEnv`.
    env
        Makes a :class:`~moral_envs.faces.GridAECEnv`.
    single_env
        Makes an environment of the class ``single``.
    vector_env
        Makes a :class:`~moral_envs.faces.GridVectorEnv`.
    """

    @overload
    def __init__(self: Faces[GridEnv], world: Callable[..., World]) -> None: ...

    @overload
    def __init__(self, world: Callable[..., World], single: type[SingleT]) -> None: ...

    def __init__(self, world: Callable[..., World], single: type[Any] = GridEnv) -> None:
        self._world = world
        self._single: type[SingleT] = single
        self.parallel_env = _of_world(self._parallel_env, world, GridParallelEnv)
        self.env = _of_world(self._env, world, GridAECEnv)
        self.single_env = _of_world(self._single_env, world, single)
        self.vector_env = _of_world(self._vector_env, world, GridVectorEnv)

    def _parallel_env(
        self,
        num_agents: int = 1,
        *,
        team_reward: bool = False,
        render_mode: str | None = None,
        view_radius: int | None = None,
        agent_rewards: Sequence[Sequence[str]] | None = None,
        **rules: Any,
    ) -> GridParallelEnv:
        """Make a PettingZoo parallel environment with vector rewards.

        Parameters
        ----------
        num_agents
            Agents, 1 to 16, named ``agent_0``, ``agent_1``, ...
        team_reward
            Pay and count every agent the sum over all agents instead of its own part.
        render_mode
            None, ``"ansi"``, ``"rgb_array"`` or ``"human"``.
        view_radius
            How many cells an agent sees in each direction. None: the whole grid.
        agent_rewards
            For each agent the names of the reward components that it is paid. None: all are paid all.

        Returns
        -------
        GridParallelEnv
            For each agent observations are uint8 of shape (C, H, W), rewards float32 of shape (k,) and
            ``infos[agent]["objectives"]`` int64 of shape (m,).
        """
        return GridParallelEnv(
            self._world(**rules), num_agents, team_reward, render_mode, view_radius, agent_rewards
        )

    def _env(
        self,
        num_agents: int = 1,
        *,
        team_reward: bool = False,
        render_mode: str | None = None,
        view_radius: int | None = None,
        agent_rewards: Sequence[Sequence[str]] | None = None,
        **rules: Any,
    ) -> GridAECEnv:
        """Make a PettingZoo agent-environment-cycle environment with vector rewards.

        Parameters
        ----------
        num_agents
            Agents, 1 to 16, named ``agent_0``, ``agent_1``, ...
        team_reward
            Pay and count every agent the sum over all agents instead of its own part.
        render_mode
            None, ``"ansi"``, ``"rgb_array"`` or ``"human"``.
        view_radius
            How many cells an agent sees in each direction. None: the whole grid.
        agent_rewards
            For each agent the names of the reward components that it is paid. None: all are paid all.

        Returns
        -------
        GridAECEnv
            ``last()`` gives an observation, uint8 of shape (C, H, W), a reward vector, float32 of shape (k,),
            and ``info["objectives"]``, int64 of shape (m,).
        """
        return GridAECEnv(
            self._world(**rules), num_agents, team_reward, render_mode, view_radius, agent_rewards
        )

    def _single_env(
        self, *, render_mode: str | None = None, view_radius: int | None = None, **rules: Any
    ) -> SingleT:
        """Make a Gymnasium environment with one agent and vector rewards.

        Parameters
        ----------
        render_mode
            None, ``"ansi"``, ``"rgb_array"`` or ``"human"``.
        view_radius
            How many cells the agent sees in each direction. None: the whole grid.

        Returns
        -------
        GridEnv
            Observations are uint8 of shape (C, H, W), rewards float32 of shape (k,) and
            ``info["objectives"]`` int64 of shape (m,).
        """
        return self._single(self._world(**rules), render_mode, view_radius)

    def _vector_env(
        self,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        num_agents: int | None = None,
        team_reward: bool = False,
        view_radius: int | None = None,
        agent_rewards: Sequence[Sequence[str]] | None = None,
        **rules: Any,
    ) -> GridVectorEnv:
        """Make a Gymnasium vector environment with vector rewards.

        Parameters
        ----------
        num_envs
            Environments in the batch.
        render_mode
            None, ``"ansi"`` or ``"rgb_array"``.
        autoreset_mode
            When an environment whose episode has ended is reset: at the next step, in the same step, or by
            the caller.
        num_agents
            Agents in each environment, 1 to 16: all that belongs to an agent then has an axis for them after
            that of the environments. None: one, and no axis for it.
        team_reward
            Pay and count every agent the sum over all agents instead of its own part.
        view_radius
            How many cells an agent sees in each direction. None: the whole grid.
        agent_rewards
            For each agent the names of the reward components that it is paid; the others are zero for it.
            None: all are paid all.

        Returns
        -------
        GridVectorEnv
            Observations are uint8 of shape (n, C, H, W), rewards float32 of shape (n, k) and
            ``infos["objectives"]`` int64 of shape (n, m); with ``num_agents`` an axis for them follows n.
        """
        return GridVectorEnv(
            self._world(**rules),
            num_envs,
            render_mode,
            autoreset_mode,
            num_agents,
            team_reward,
            view_radius,
            agent_rewards,
        )


def _of_world(method: _Function, world: Callable[..., World], made: type) -> _Function:
    """Return a function of the world's module that shows the method's parameters and the world's own."""
    name = method.__name__.removeprefix("_")
    shown = _signature(method)
    rules = list(_signature(world).parameters.values())
    takes_any = any(rule.kind is Parameter.VAR_KEYWORD for rule in rules)
    own = [given for given in shown.parameters.values() if given.kind is not Parameter.VAR_KEYWORD]
    known = [given.name for given in (*own, *rules)]

    positional = [given.name for given in own if given.kind is Parameter.POSITIONAL_OR_KEYWORD]

    def face(*args: Any, **kwargs: Any) -> Any:
        if len(args) > len(positional):
            first = f"only {positional[0]} may be" if positional else "none may be"
            raise TypeError(f"{name}() has {len(args)} arguments without a name; {first}")
        unknown = [argument for argument in kwargs if argument not in known]
        if unknown and not takes_any:
            raise TypeError(f"{name}() has no argument {unknown[0]!r}; {_advice(name, unknown[0], known)}")
        return method(*args, **kwargs)

    face.__name__ = face.__qualname__ = name
    face.__module__ = getattr(world, "__module__", __name__)
    face.__doc__ = _docstring(method, world)
    named = [
        rule if rule.kind is Parameter.VAR_KEYWORD else rule.replace(kind=Parameter.KEYWORD_ONLY)
        for rule in rules
    ]
    # Where Gymnasium looks for render modes before it makes an environment.
    modes = [mode for mode in RENDER_MODES if name != "vector_env" or mode != "human"]
    face.metadata = {"render_modes": modes, "render_fps": RENDER_FPS}  # type: ignore[attr-defined]
    face.__signature__ = shown.replace(parameters=[*own, *named], return_annotation=made)  # type: ignore[attr-defined]
    return cast(_Function, face)


def _advice(name: str, argument: str, known: Sequence[str]) -> str:
    if name == "single_env" and argument in ("num_agents", "team_reward", "agent_rewards"):
        return "for several agents use parallel_env, env or vector_env"
    return f"it must be one of {', '.join(known)}"


def _signature(function: Callable[..., Any]) -> Signature:
    """Return a signature, its annotations evaluated where that is possible."""
    try:
        return inspect.signature(function, eval_str=True)
    except NameError:  # Some names are only there for type checkers.
        return inspect.signature(function)


def _docstring(method: Callable[..., Any], world: Callable[..., World]) -> str:
    """Return the method's docstring with the parameters from that of the world."""
    text, rules = inspect.getdoc(method) or "", inspect.getdoc(world) or ""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=\n\n\S[^\n]*\n-+\n|\Z)", rules, re.DOTALL | re.MULTILINE)
    if section is None:
        return text
    parameters, returns = text.split("\n\nReturns\n", 1)
    return f"{parameters}\n{section[1].rstrip()}\n\nReturns\n{returns}"

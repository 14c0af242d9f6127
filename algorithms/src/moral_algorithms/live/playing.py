"""Demonstrations by people: episodes played step by step, reviewed, and kept or discarded."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from moral_algorithms.demonstrations import Demonstrations
from moral_algorithms.live.frames import describe_episode, describe_moment, draw_frames, start
from moral_algorithms.live.session import Refusal, hold
from moral_algorithms.replay import Replay
from moral_algorithms.worlds import WorldSpec
from moral_envs.engine import Engine
from moral_envs.rendering import draw_ansi

NORMS: dict[str, dict[str, str]] = {
    "emergency": {
        "save": "Get everybody out: save as many people as you can, and do not worry about the fire.",
        "extinguish": "Fight the fire: go to the extinguisher and stay with it for as long as you can.",
    },
    "delivery": {
        "deliver": "Deliver as many parcels as you can, and do not break a vase on your way.",
        "help": "Help as many people as you can, and do not break a vase on your way.",
        "clean": "Clean up as much pollution as you can, and do not break a vase on your way.",
    },
}
"""The thesis's norms in one sentence each, by world and name."""

KEYS = {
    "ArrowUp": 0,
    "ArrowDown": 1,
    "ArrowLeft": 2,
    "ArrowRight": 3,
    " ": 4,
    "w": 5,
    "s": 6,
    "a": 7,
    "d": 8,
}
"""Actions by the names that browsers give to keys."""

# Unfinished episodes that are remembered.
_MOST = 16


@dataclass(eq=False)
class Play:
    """An episode that a person plays."""

    name: str
    """By which it is spoken of."""
    stream: int
    """State of the engine's random stream before the reset."""
    engine: Engine
    """How it stands."""
    actions: list[int] = field(default_factory=list)
    """The actions so far."""
    kept: bool = False
    """Whether it is in the file."""

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return len(self.actions) == self.engine.world.horizon

    @property
    def replay(self) -> Replay:
        """The episode so far."""
        return Replay(self.stream, np.array(self.actions, dtype=np.uint8)[:, None])

    def describe(self) -> dict[str, Any]:
        """PLAY, as docs/live-protocol.md tells it."""
        moment = describe_moment(self.engine)
        horizon = self.engine.world.horizon
        return {
            "play": self.name,
            "step": len(self.actions),
            "horizon": horizon,
            "over": self.over,
            **moment,
        }


class Plays:
    """The plays of a session, and the file that those which are kept go to; safe for several threads.

    Parameters
    ----------
    spec
        Where they are played; every episode must be equally long.
    out
        The demonstration file; episodes are added to one that is there.
    wanted
        How many are to be kept.
    instruction
        What people are asked to do.

    Raises
    ------
    ValueError
        If ``wanted`` is below 1 or the world's episodes differ in length.
    StorageError
        If the file that is there is damaged, or of another world.
    """

    def __init__(self, spec: WorldSpec, out: Path, wanted: int, instruction: str) -> None:
        self.spec = spec
        self.out = out
        self.world = spec.build()
        self.wanted = wanted
        self.instruction = instruction
        self._plays: dict[str, Play] = {}
        self._lock = threading.Lock()
        if wanted < 1:
            raise ValueError(f"episodes is {wanted}; it must be at least 1")
        if self.world.ends_early:
            raise ValueError(f"world is {spec.name!r}; its episodes must all take the same number of steps")
        self._kept = Demonstrations.load(out, spec) if out.exists() else None

    @property
    def num_kept(self) -> int:
        """Episodes in the file."""
        return 0 if self._kept is None else self._kept.num_episodes

    def describe(self) -> dict[str, Any]:
        """DEMONSTRATIONS, as docs/live-protocol.md tells it."""
        return {
            "kept": self.num_kept,
            "wanted": self.wanted,
            "instruction": self.instruction,
            "out": self.out.name,
            "keys": {key: action for key, action in KEYS.items() if action < self.world.num_actions},
        }

    def begin(self) -> dict[str, Any]:
        """Start an episode; returns PLAY."""
        stream = secrets.randbits(64)
        play = Play(secrets.token_hex(4), stream, start(self.world, stream))
        with self._lock:
            while len(self._plays) >= _MOST:
                del self._plays[next(iter(self._plays))]
            self._plays[play.name] = play
        return play.describe()

    def look(self, name: str) -> dict[str, Any]:
        """Tell how a play stands.

        Raises
        ------
        Refusal
            If there is none of that name.
        """
        with self._lock:
            return self._find(name).describe()

    def step(self, name: str, action: int, step: int) -> dict[str, Any]:
        """Take a step that was chosen after ``step`` others.

        Raises
        ------
        Refusal
            If there is no such play or action, it is over, or the step is not the next one.
        """
        if not 0 <= action < self.world.num_actions:
            most = self.world.num_actions - 1
            raise Refusal(400, "malformed", f"action is {action}; it must be 0 to {most}")
        with self._lock:
            play = self._find(name)
            if step != len(play.actions):
                detail = f"step is {step}; the next one is {len(play.actions)}"
                raise Refusal(409, "step", detail, play=play.describe())
            if play.over:
                raise Refusal(409, "over", "the episode has ended", play=play.describe())
            play.engine.step(np.array([[action]]))
            play.actions.append(action)
            return play.describe()

    def review(self, name: str) -> dict[str, Any]:
        """Tell the episode so far, without what it counts.

        Raises
        ------
        Refusal
            If there is none of that name.
        """
        with self._lock:
            return describe_episode(self.world, self._find(name).replay, counted=False)

    def frame(self, name: str) -> str:
        """Draw how a play stands, as text.

        Raises
        ------
        Refusal
            If there is none of that name.
        """
        with self._lock:
            engine = self._find(name).engine
            return draw_ansi(self.world, engine.world_planes()[0], engine.agent_cells[0])

    def frames(self, name: str) -> list[str]:
        """Draw every state of a play so far, as text.

        Raises
        ------
        Refusal
            If there is none of that name.
        """
        with self._lock:
            return draw_frames(self.world, self._find(name).replay)

    def keep(self, name: str) -> dict[str, Any]:
        """Add a finished episode to the file; it is on the disk afterwards, once.

        Raises
        ------
        Refusal
            If there is no such play, or it has not ended.
        StorageError
            If the file could not be written; it is as it was then.
        """
        with self._lock:
            play = self._find(name)
            if not play.over:
                raise Refusal(409, "not_over", "the episode has not ended yet")
            duplicate = play.kept
            if not duplicate:
                kept = _with_episode(self._kept, self.spec, play.replay)
                kept.save(self.out)
                self._kept, play.kept = kept, True
            return {"kept": self.num_kept, "duplicate": duplicate}

    def discard(self, name: str) -> dict[str, Any]:
        """Forget a play.

        Raises
        ------
        Refusal
            If there is none of that name, or it was kept.
        """
        with self._lock:
            if self._find(name).kept:
                raise Refusal(404, "unknown", "the episode was kept")
            del self._plays[name]
            return {"kept": self.num_kept}

    def _find(self, name: str) -> Play:
        if name not in self._plays:
            raise Refusal(404, "unknown", "there is no such episode any more")
        return self._plays[name]


def _with_episode(kept: Demonstrations | None, spec: WorldSpec, replay: Replay) -> Demonstrations:
    """Play an episode again and put it after those that there are."""
    world = spec.build()
    engine = start(world, replay.stream)
    states = [engine.observe()[0, 0]]
    for actions in replay.actions:
        engine.step(actions[None])
        states.append(engine.observe()[0, 0])
    played = Demonstrations(spec, np.stack(states)[None], replay.actions.T, engine.objectives[:, 0])
    if kept is None:
        return played
    return Demonstrations(
        spec,
        np.concatenate([kept.states, played.states]),
        np.concatenate([kept.actions, played.actions]),
        np.concatenate([kept.objectives, played.objectives]),
    )


@contextmanager
def hold_plays(out: Path) -> Iterator[Path]:
    """Keep other processes from adding to a file until the block ends; yields a folder for what is beside it.

    Raises
    ------
    StorageError
        If another process adds to it already, or the folder cannot be made.
    """
    folder = out.with_name(f".{out.name}.live")
    with hold(folder, f"somebody demonstrates into {out} already, in another process"):
        yield folder


def find_instruction(spec: WorldSpec, norm: str | None) -> str:
    """Find what people are asked to do, by the name of a norm; None takes the world's first.

    Raises
    ------
    ValueError
        If there is no such norm, or people cannot play in the world.
    """
    if spec.name not in NORMS:
        raise ValueError(f"world is {spec.name!r}; for people to play in it must be one of {sorted(NORMS)}")
    norms = NORMS[spec.name]
    if norm is None:
        return next(iter(norms.values()))
    if norm not in norms:
        raise ValueError(f"norm is {norm!r}; in {spec.name} it must be one of {sorted(norms)}")
    return norms[norm]

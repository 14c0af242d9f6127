"""PPO beside people who answer: schedules that follow their pace, and a file that tells how things stand."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from moral_algorithms.bridge import ScalarisedRewards
from moral_algorithms.learners.asking import Episode
from moral_algorithms.learners.pace import Pace
from moral_algorithms.learners.ppo import ObjectiveMonitor, PPOConfig, learn
from moral_algorithms.learners.query_queue import QueryQueue
from moral_algorithms.preferences import Posterior
from moral_algorithms.preferences.priors import normalise_rows
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import write_json

STATUS_VERSION = 1

# Samples of the weights in the status.
_SAMPLES = 200
# Seconds between two looks for an answer while training rests.
_REST = 0.2


class PaceSchedule(BaseCallback):
    """Moves PPO's step size and entropy bonus with the progress of a `Pace` instead of the steps."""

    def __init__(self, config: PPOConfig, pace: Pace) -> None:
        super().__init__()
        self._config = config
        self._pace = pace

    def _init_callback(self) -> None:
        assert isinstance(self.model, PPO)
        self.model.lr_schedule = lambda _: self._config.learning_rate * max(1 - self._progress, 0.05)

    def _on_rollout_start(self) -> None:
        assert isinstance(self.model, PPO)
        start, end = self._config.entropy_start, self._config.entropy_end
        self.model.ent_coef = start + self._progress * (end - start)

    def _on_step(self) -> bool:
        return True

    @property
    def _progress(self) -> float:
        return self._pace.progress(self.model.num_timesteps)


class StatusWriter(BaseCallback):
    """Writes ``status.json`` after every rollout, for whoever shows how the training stands.

    What it holds is told in docs/live-protocol.md, under STATUS; ``episode`` is the agent's latest one, by
    reference.

    Parameters
    ----------
    venv
        Knows the components and the weights.
    posterior
        What is known of the weights.
    queue
        Knows how far the answers are.
    monitor
        Knows the objectives.
    recent
        The last finished episodes.
    directory
        Where it writes.
    """

    def __init__(
        self,
        venv: ScalarisedRewards,
        posterior: Posterior,
        queue: QueryQueue,
        monitor: ObjectiveMonitor,
        recent: deque[Episode],
        directory: RunDirectory,
    ) -> None:
        super().__init__()
        self._venv = venv
        self._posterior = posterior
        self._queue = queue
        self._monitor = monitor
        self._recent = recent
        self._directory = directory

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self.write("closing" if self._queue.pace.closing else "training", self.num_timesteps)

    def write(self, phase: str, env_steps: int) -> None:
        """Write the file.

        Raises
        ------
        StorageError
            If it cannot be written.
        """
        samples = normalise_rows(self._posterior.samples[:_SAMPLES])
        status = {
            "progress": self._queue.pace.progress(env_steps),
            "env_steps": env_steps,
            "components": list(self._venv.names),
            "weights": [round(weight, 6) for weight in self._posterior.weights().tolist()],
            "samples": [[round(weight, 4) for weight in sample] for sample in samples.tolist()],
            "answers": self._posterior.num_queries,
            "objectives": list(self._monitor.means.values()),
            "advice": self._queue.advice(),
            "episode": self._recent[-1].replay.to_json() if self._recent else None,
        }
        write_status(self._directory.path, phase, status)


def write_status(run: Path, phase: str, values: dict[str, Any]) -> None:
    """Write ``status.json`` of a run.

    Raises
    ------
    StorageError
        If it cannot be written.
    """
    write_json(run / "status.json", {"version": STATUS_VERSION, "phase": phase, **values})


def learn_at_pace(
    model: PPO, callbacks: Sequence[BaseCallback], queue: QueryQueue, status: StatusWriter
) -> None:
    """Train from where the model stands until the answers are in and the training after them is done.

    Parameters
    ----------
    model
        What is trained, rollout by rollout.
    callbacks
        What goes with it.
    queue
        Knows the pace, and whether somebody answers.
    status
        Told when training rests.
    """
    queue.take_in(model.num_timesteps)
    while not (queue.pace.closing and queue.pace.progress(model.num_timesteps) >= 1):
        if queue.is_idle(model.num_timesteps):
            status.write("resting", model.num_timesteps)
            while queue.is_idle(model.num_timesteps):
                time.sleep(_REST)
                queue.take_in(model.num_timesteps)
        learn(model, model.num_timesteps + 1, callbacks)

"""How a training is saved between two rollouts and goes on exactly from there."""

from __future__ import annotations

from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from moral_algorithms.learners.ppo import ObjectiveMonitor, load_ppo_state, ppo_state
from moral_algorithms.run_directory import RunDirectory, read_lines, repair_lines, write_lines
from moral_algorithms.storage import Arrays, StorageError, first_line, read_tensors, write_tensors


def require_unstarted(directory: RunDirectory) -> None:
    """Raise a StorageError if a training has left a checkpoint or queries in a directory."""
    for path in (directory.checkpoint, directory.queries):
        if path.exists():
            raise StorageError(f"{path} is there already; resume that run or choose another folder")


class ResumableLearner(BaseCallback):
    """A learner that may be stopped at any moment and goes on from its last checkpoint.

    It acts between rollouts, where training can be saved and continued exactly, and writes one line of
    metrics, with ``env_steps``, for each.

    Parameters
    ----------
    kind
        What its checkpoints are; others are refused.
    directory
        Where it writes.
    monitor
        Its objectives are saved, too.
    steps_before
        Environment steps that were taken before PPO's.
    """

    def __init__(
        self, kind: str, directory: RunDirectory, monitor: ObjectiveMonitor, steps_before: int = 0
    ) -> None:
        super().__init__()
        self._kind = kind
        self._directory = directory
        self._monitor = monitor
        self._steps_before = steps_before

    def state_dict(self) -> tuple[Arrays, dict[str, Any]]:
        """Copy what it needs to go on beside PPO's state, as arrays and JSON-able values."""
        raise NotImplementedError

    def load_state_dict(self, arrays: Arrays, metadata: dict[str, Any]) -> None:
        """Go on where :meth:`state_dict` was taken.

        Raises
        ------
        KeyError, TypeError, ValueError, IndexError, RuntimeError
            If the state is damaged or of another run.
        """
        raise NotImplementedError

    def restore(self, model: PPO) -> None:
        """Go on from the last checkpoint, if there is one; the answers on the disk must have been read.

        Raises
        ------
        StorageError
            If what is in the run directory is damaged or of another run.
        """
        repair_lines(self._directory.metrics)
        if self._directory.checkpoint.exists():
            try:
                self._load_checkpoint(model)
            except StorageError as error:
                raise StorageError(
                    f"{error}; without that file the run begins anew, with the answers that were given"
                ) from error
        # Training goes through the rollouts after the checkpoint once more, and writes their lines again.
        lines = read_lines(self._directory.metrics)
        kept = [line for line in lines if line["env_steps"] <= model.num_timesteps + self._steps_before]
        if len(kept) < len(lines):
            write_lines(self._directory.metrics, kept)

    def _load_checkpoint(self, model: PPO) -> None:
        arrays, metadata = read_tensors(self._directory.checkpoint, self._kind)
        try:
            load_ppo_state(model, arrays, metadata["ppo"])
            self.load_state_dict(arrays, metadata)
            self._monitor.means = metadata["objectives"]
        except StorageError:
            raise
        except (KeyError, TypeError, ValueError, IndexError, RuntimeError) as error:
            reason = first_line(error)
            raise StorageError(f"{self._directory.checkpoint} does not fit this run: {reason}") from error

    def save(self, model: PPO) -> None:
        """Write a checkpoint.

        Raises
        ------
        StorageError
            If it cannot be written; the last one is untouched then.
        """
        arrays, ppo = ppo_state(model)
        own, metadata = self.state_dict()
        metadata = {"kind": self._kind, "ppo": ppo, **metadata, "objectives": self._monitor.means}
        write_tensors(self._directory.checkpoint, arrays | own, metadata)

"""The training process of a live session: ``python -m moral_algorithms.live.training RUN``.

It resumes the run in a directory that was prepared for it, and ends when the process that started it is gone:
that holds the other end of its standard input.
"""

from __future__ import annotations

import _thread
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from moral_algorithms import pipeline
from moral_algorithms.learners.beside_people import STATUS_VERSION, write_status
from moral_algorithms.learners.ppo import OnProgress, Progress
from moral_algorithms.pipeline.alignment import KIND
from moral_algorithms.processes import prepare_process
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import read_json

_EMPTY = {
    "env_steps": 0,
    "components": [],
    "weights": [],
    "samples": [],
    "answers": 0,
    "objectives": [],
    "advice": None,
    "episode": None,
}
# Seconds that an interrupted training gets to end by itself.
_GRACE = 5.0


def train(run: Path) -> None:
    """Train until the end, telling in ``status.json`` how it stands.

    Raises
    ------
    ValueError, OSError
        As in `moral_algorithms.pipeline.moral`.
    """
    directory = RunDirectory(run)
    moral_run, setting = pipeline.read_moral_run(directory), pipeline.read_setting(directory, KIND)
    # The run's own record says auto or a device; both are known there.
    prepare_process(setting.threads)

    @contextmanager
    def stage(title: str) -> Iterator[OnProgress]:
        def show(progress: Progress) -> None:
            if title == "primary":
                _prepare(min(1.0, progress.steps / progress.total_steps))

        if title == "primary":
            _prepare(0.0)
        yield show

    def _prepare(progress: float) -> None:
        write_status(run, "preparing", {"progress": progress, **_EMPTY})

    pipeline.moral(directory, moral_run, replace(setting, stage=stage), resume=True)
    status = read_json(run / "status.json")
    known = isinstance(status, dict) and status.get("version") == STATUS_VERSION
    values = {**_EMPTY, **(status if known else {})}
    write_status(run, "finished", {name: values[name] for name in _EMPTY} | {"progress": 1.0})


def _end_with_parent() -> None:
    """Interrupt the training when standard input ends, which it does with the process that holds it."""
    # Not through sys.stdin, whose lock a thread that waits would still hold when Python ends.
    os.read(0, 1)
    _thread.interrupt_main()
    threading.Event().wait(_GRACE)
    os._exit(1)


def main(arguments: Sequence[str]) -> int:
    """Run the command line; returns the exit status."""
    try:
        threading.Thread(target=_end_with_parent, daemon=True).start()
        train(Path(arguments[0]))
    except KeyboardInterrupt:
        return 130
    except (ValueError, OSError) as error:
        print(f"moral: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Commands whose output nobody reads to its end."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence


def run_into_closed_pipe(command: Sequence[str], unbuffered: bool) -> tuple[int, str]:
    """Exit status and errors of a command whose reader has gone before it writes anything."""
    reading, writing = os.pipe()
    os.close(reading)
    environment = {**os.environ, "PYTHONUNBUFFERED": "1" if unbuffered else ""}
    try:
        done = subprocess.run(
            command, stdout=writing, stderr=subprocess.PIPE, text=True, env=environment, check=False
        )
    finally:
        os.close(writing)
    return done.returncode, done.stderr

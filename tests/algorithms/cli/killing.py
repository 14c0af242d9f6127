"""Commands that are killed at given moments."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

# Runs `moral` once for every moment, in copies of this process, for PyTorch takes seconds to import. A copy
# kills itself when a file is about to be flushed to the disk at its moment. Prints how each ended.
_SCRIPT = """
import json, os, signal, sys
from pathlib import Path
from moral_algorithms.cli import main
import moral_algorithms.pipeline

folder, moments, command = Path(sys.argv[1]), json.loads(sys.argv[2]), sys.argv[3:]
flush = os.fsync

def run_and_die(out, moment):
    def lines(name):
        return (out / name).read_bytes().count(b"\\n") if (out / name).exists() else 0

    def writing(name):
        return any(out.glob(f".{name}.*"))

    def flush_or_die(handle):
        if eval(moment, {"lines": lines, "writing": writing}):
            os.kill(os.getpid(), signal.SIGKILL)
        flush(handle)

    os.fsync = flush_or_die
    os.dup2(2, 1)
    main([*command, "--out", str(out)])

ended = {}
for name, moment in moments.items():
    child = os.fork()
    if child == 0:
        try:
            run_and_die(folder / name, moment)
        finally:
            os._exit(3)
    ended[name] = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
print(json.dumps(ended))
"""


def killed(command: Sequence[str], moments: Mapping[str, str], folder: Path) -> dict[str, Path]:
    """Run folders that ``moral COMMAND`` has left when it was killed, by the names of the moments.

    A moment is an expression of ``lines('queries.jsonl')``, how many lines a file of the run has, and
    ``writing('summary.json')``, whether it is being written.
    """
    script = [sys.executable, "-c", _SCRIPT, str(folder), json.dumps(dict(moments)), *command]
    done = subprocess.run(script, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == dict.fromkeys(moments, -9), done.stderr
    return {name: folder / name for name in moments}

"""Sweeps on a cluster of Ray: one that is started here, and one that runs already."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from benchmarks.harness import Store
from benchmarks.harness.errors import UsageError
from benchmarks.harness.executors import RayCluster

ROOT = Path(__file__).parents[3]
needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="Ray has no release for this Python")

# In a process of its own: Ray leaves threads and handlers behind.
SWEEP = """
import json, sys
from pathlib import Path
from benchmarks.harness import Store
from benchmarks.harness.executors import RayCluster
from benchmarks.harness.sweep import Sweep
from tests.benchmarks.harness.runs import Failing, Square, Threads, Total, Written

store = Store(Path(sys.argv[1]))
total, failing = Total((Written(2), Square(3))), Failing(2)
sweep = Sweep(store, [total, Threads(), failing])
executor = RayCluster(store, sys.argv[2], 2 if sys.argv[2] == "local" else None, ["tests"])
sweep.carry_out(executor, lambda sweep: None, lambda outcome: None)
print(json.dumps({
    "jobs": executor.jobs,
    "total": store.result(total),
    "files": store.is_complete(Written(2)),
    "threads": store.result(Threads()),
    "commit": store.record(total)["commit"],
    "failed": [(outcome.run == failing, outcome.error) for outcome in sweep.failed],
    "log": store.log_path(failing).read_text(),
    "held": store.is_held(failing),
}))
"""


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    # Not pytest's folder: the paths of Ray's sockets may have no more than 107 characters.
    with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as folder:
        yield {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)]),
            "RAY_TMPDIR": folder,
            "RAY_USAGE_STATS_ENABLED": "0",
        }


def sweep(address: str, out: Path, environment: dict[str, str]) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", SWEEP, str(out), address],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def require_done(found: dict[str, Any]) -> None:
    assert found["jobs"] == 2
    assert found["total"] == {"total": 13}
    assert found["files"]
    # Committed results are not sent along.
    assert found["threads"] == {"torch": 1, "omp": "1", "results": False}
    ((of_failing, error),) = found["failed"]
    assert of_failing
    assert error.endswith("RuntimeError: it was not to be")
    assert found["log"] == f"{error}\n"
    assert not found["held"]


@needs_ray
def test_a_cluster_that_is_started_here(tmp_path: Path, environment: dict[str, str]) -> None:
    require_done(sweep("local", tmp_path, environment))


@needs_ray
def test_a_cluster_that_runs_already(tmp_path: Path, environment: dict[str, str]) -> None:
    ray = [sys.executable, "-m", "ray.scripts.scripts"]
    address = f"127.0.0.1:{free_port()}"
    head = subprocess.Popen(
        [
            *(*ray, "start", "--head", "--block", f"--port={address.rpartition(':')[2]}", "--num-cpus=2"),
            *("--num-gpus=0", "--include-dashboard=false", "--node-ip-address=127.0.0.1"),
        ],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert head.stdout is not None
        assert any("Ray runtime started" in line for line in head.stdout)
        require_done(sweep(address, tmp_path, environment))
    finally:
        head.terminate()
        head.communicate()


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
    return port


@needs_ray
@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("somewhere", "it must be HOST:PORT, ray://HOST:PORT or local"),
        ("127.0.0.1:1", "Connection refused"),
        ("ray://127.0.0.1:1", "Connection refused"),
    ],
)
def test_an_address_where_nothing_answers_takes_one_line(address: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        RayCluster(Store(tmp_path), address)
    assert str(caught.value).startswith(f"ray is {address!r}, where no cluster answers: ")
    assert "\n" not in str(caught.value)


def test_without_ray_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError, match="pip install ray"):
        RayCluster(Store(tmp_path), "local")

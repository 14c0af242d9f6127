"""Sweeps on a cluster of Ray: one that is started here, and one that runs already."""

from __future__ import annotations

import json
import os
import pickle
import secrets
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from benchmarks.harness import Store, executors
from benchmarks.harness.errors import UsageError
from benchmarks.harness.executors import RayCluster
from benchmarks.harness.sweep import Sweep
from tests.benchmarks.harness.runs import Failing, Square, Total, Written

ROOT = Path(__file__).parents[3]
needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="Ray has no release for this Python")

# In processes of their own: Ray leaves threads and handlers behind.
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
executor = RayCluster(store, sys.argv[2], modules=["tests"])
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

# No more than it takes to see that a cluster has been started: each of its processes imports PyTorch.
LOCAL = """
import json, sys
from pathlib import Path
from benchmarks.harness import Store
from benchmarks.harness.executors import RayCluster
from benchmarks.harness.sweep import Sweep
from tests.benchmarks.harness.runs import Square

store = Store(Path(sys.argv[1]))
executor = RayCluster(store, "local", 1, ["tests"])
Sweep(store, [Square(3)]).carry_out(executor, lambda sweep: None, lambda outcome: None)
print(json.dumps({"jobs": executor.jobs, **store.result(Square(3))}))
"""


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    # Not pytest's folder: the paths of Ray's sockets may have no more than 107 characters.
    with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as folder:
        yield {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)]),
            "RAY_TMPDIR": folder,
            # Otherwise Ray would look for a token in the home directory, or leave one there.
            "RAY_AUTH_MODE": "token",
            # However slow the machine is.
            "RAY_worker_register_timeout_seconds": "3600",
            "RAY_AUTH_TOKEN": secrets.token_hex(32),
            "RAY_USAGE_STATS_ENABLED": "0",
        }


def run(script: str, environment: dict[str, str], out: Path, *arguments: str) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", script, str(out), *arguments],
        cwd=out,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


class RefusedTask(Exception):
    """What Ray raises when a task is lost."""


class PretendedRay:
    """Ray as far as it is used, in this process: what goes to a task and comes back is pickled."""

    exceptions = SimpleNamespace(RayError=RefusedTask)

    def __init__(self) -> None:
        self.initialised: dict[str, Any] = {}
        self.stored: list[bytes] = []
        self.lost = False

    def init(self, **arguments: Any) -> None:
        self.initialised = arguments

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": 3.0}

    def put(self, value: object) -> Reference:
        self.stored.append(pickle.dumps(value))
        return Reference(len(self.stored) - 1)

    def get(self, reference: Reference) -> Any:
        if self.lost:
            raise RefusedTask("the machine was lost\n")
        return pickle.loads(self.stored[reference.number])  # noqa: S301

    def remote(self, **resources: Any) -> Any:
        assert resources == {"num_cpus": 1, "max_retries": 2}

        def decorate(task: Any) -> SimpleNamespace:
            def remote(*arguments: Any) -> Reference:
                given = [self.get(one) if isinstance(one, Reference) else one for one in arguments]
                return self.put(task(*pickle.loads(pickle.dumps(given))))  # noqa: S301

            return SimpleNamespace(remote=remote)

        return decorate

    def wait(self, references: list[Reference], timeout: float) -> tuple[list[Reference], list[Reference]]:
        return references[:1], references[1:]

    def cancel(self, reference: Reference, force: bool) -> None:
        assert force

    def shutdown(self) -> None:
        self.initialised = {}


class Reference(NamedTuple):
    number: int


@pytest.fixture
def pretended(monkeypatch: pytest.MonkeyPatch) -> PretendedRay:
    ray = PretendedRay()
    monkeypatch.setitem(sys.modules, "ray", ray)  # type: ignore[misc]
    # Processes of the tests keep their threads.
    monkeypatch.setattr(executors, "prepare_process", lambda: None)
    return ray


def test_tasks_are_sent_what_they_read_and_send_back_what_they_leave(
    tmp_path: Path, pretended: PretendedRay
) -> None:
    store = Store(tmp_path)
    shared, failing = Written(2), Failing(2)
    runs = [Total((shared, Square(3))), Total((shared,)), failing]
    executor = RayCluster(store, "local", modules=["tests.benchmarks"])
    environment = pretended.initialised["runtime_env"]
    sent = [Path(path) for path in environment["py_modules"]]
    assert [path.name for path in sent] == ["benchmarks", "moral_algorithms", "moral_envs", "tests"]
    assert sent[0] == ROOT / "benchmarks"
    assert sent[-1] == ROOT / "tests"
    assert executor.jobs == 3
    sweep = Sweep(store, runs)
    sweep.carry_out(executor, lambda sweep: None, lambda outcome: None)
    assert pretended.initialised == {}
    assert [store.result(run)["total"] for run in runs[:2]] == [13, 4]
    assert (store.files(shared) / "square.txt").read_text() == "4"
    assert store.is_complete(shared)
    ((failed, error),) = sweep.failed
    assert failed == failing
    assert (error or "").endswith("RuntimeError: it was not to be")
    assert store.log_path(failing).read_text() == f"{error}\n"


def test_a_task_that_is_lost_has_failed(tmp_path: Path, pretended: PretendedRay) -> None:
    store = Store(tmp_path)
    executor = RayCluster(store, "local", jobs=1)
    executor.start(Square(3))
    assert Store(tmp_path).is_held(Square(3))
    pretended.lost = True
    assert executor.wait(1.0) == [(Square(3), "the machine was lost")]
    assert not Store(tmp_path).is_held(Square(3))
    assert executor.wait(0.0) == []


def test_what_is_running_is_given_free_when_a_cluster_is_left(
    tmp_path: Path, pretended: PretendedRay
) -> None:
    store = Store(tmp_path)
    executor = RayCluster(store, "local")
    executor.start(Square(3))
    executor.stop()
    assert not store.is_held(Square(3))
    assert store.record(Square(3)) is None


@needs_ray
def test_a_cluster_that_is_started_here(tmp_path: Path, environment: dict[str, str]) -> None:
    assert run(LOCAL, environment, tmp_path) == {"jobs": 1, "square": 9}


@needs_ray
def test_a_cluster_that_runs_already(tmp_path: Path, environment: dict[str, str]) -> None:
    ray = [sys.executable, "-m", "ray.scripts.scripts"]
    address = f"127.0.0.1:{free_port()}"
    head = subprocess.Popen(
        [
            *(*ray, "start", "--head", "--block", f"--port={address.rpartition(':')[2]}", "--num-cpus=2"),
            *("--num-gpus=0", "--include-dashboard=false", "--node-ip-address=127.0.0.1"),
        ],
        # Like another machine, it is not told where the packages are.
        env={name: value for name, value in environment.items() if name != "PYTHONPATH"},
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert head.stdout is not None
        assert any("Ray runtime started" in line for line in head.stdout)
        found = run(SWEEP, environment, tmp_path, address)
        assert found["jobs"] == 2
        assert found["total"] == {"total": 13}
        assert found["files"]
        assert (found["threads"]["torch"], found["threads"]["omp"]) == (1, "1")
        ((of_failing, error),) = found["failed"]
        assert of_failing
        assert error.endswith("RuntimeError: it was not to be")
        assert found["log"] == f"{error}\n"
        assert not found["held"]
        # The code is that which was sent, without the committed results.
        assert Path(found["threads"]["package"]).is_relative_to(environment["RAY_TMPDIR"])
        assert found["threads"]["results"] == 0
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

"""What the strangers' results files hold besides their figures, and how they are written.

Nothing here imports moral-algorithms: it is not installed where the strangers run.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import time
from collections.abc import Sequence
from importlib.metadata import distribution, version
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parents[1] / "results"
PACKAGES = ("moral-envs", "numpy", "gymnasium", "pettingzoo")


def results_file(stranger: str) -> Path:
    """Where the results of one stranger are kept."""
    return RESULTS / f"strangers_{stranger}.json"


def provenance(started: float, packages: Sequence[str]) -> dict[str, Any]:
    """Describe the run.

    Parameters
    ----------
    started
        When it began, by ``time.perf_counter``.
    packages
        Distributions that took part, besides moral-envs and what that needs.
    """
    return {
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in (*PACKAGES, *packages)},
        },
        "moral_envs_wheel": installed_wheel(),
        "commit": commit(),
        "platform": platform.platform(),
        "processor": processor(),
        "duration_seconds": round(time.perf_counter() - started, 1),
    }


def installed_wheel() -> str | None:
    """SHA-256 of the wheel that moral-envs was installed from; None for an editable or other installation."""
    origin = json.loads(distribution("moral-envs").read_text("direct_url.json") or "{}")
    digest = origin.get("archive_info", {}).get("hashes", {}).get("sha256")
    return digest if isinstance(digest, str) else None


def commit() -> str | None:
    """Commit of the working tree, marked if changed; None without one."""
    question = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        answer = subprocess.run([*question, "--exclude=*"], capture_output=True, check=True, text=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return answer.stdout.strip()


def processor() -> str:
    """Name of the processor, as exactly as the system tells it."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def store(path: Path, record: dict[str, Any]) -> None:
    """Write a record as JSON; the file appears only when it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(json.dumps(record, indent=2) + "\n")
    temporary.replace(path)


def kept_runs(path: Path, seeds: Sequence[int], config: dict[str, Any]) -> list[dict[str, Any]]:
    """Find runs that an interrupted call with the same settings has left.

    Parameters
    ----------
    path
        The results file, if there is one.
    seeds
        Seeds that are wanted.
    config
        The settings; which seeds they name does not matter.
    """
    if not path.exists():
        return []
    stored = json.loads(path.read_text())
    same = {**stored["config"], "seeds": None} == json.loads(json.dumps({**config, "seeds": None}))
    return [one for one in stored["runs"] if one["seed"] in seeds] if same else []

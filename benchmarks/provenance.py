"""What a results file says of where its figures come from."""

from __future__ import annotations

import platform
import time
from pathlib import Path
from typing import Any

from moral_algorithms.run_directory import commit, versions


def provenance(started: float) -> dict[str, Any]:
    """Describe the run: versions, commit, machine and the seconds since ``started`` (``perf_counter``)."""
    return {
        "versions": versions(),
        "commit": commit(),
        "platform": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "duration_seconds": round(time.perf_counter() - started, 1),
    }


def processor() -> str:
    """Find the name of the processor, as exactly as the system tells it."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())

"""Settings of every test: no outcome depends on time, and a run is the same for the same tree."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("moral", deadline=None, derandomize=True)
settings.load_profile("moral")

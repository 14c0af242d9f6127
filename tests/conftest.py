"""Settings of every test: no outcome depends on time, and a run is the same for the same tree."""

from __future__ import annotations

import signal

from hypothesis import settings

settings.register_profile("moral", deadline=None, derandomize=True)
settings.load_profile("moral")

# What a script starts in its background is told to ignore Ctrl-C, and so would be all that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)

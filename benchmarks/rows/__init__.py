"""One module per figure or table of the thesis, and per comparison; each has a ``BENCHMARK``."""

ORDER: tuple[str, ...] = ()
"""The modules, in the order of the report."""

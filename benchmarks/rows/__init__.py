"""One module per figure or table of the thesis, and per comparison; each has a ``BENCHMARK``."""

ORDER: tuple[str, ...] = (
    *("e1", "e2", "e3", "e4", "e5", "e6", "e7", "e8", "p1"),
    *("d1", "d2", "d3", "d4", "d5", "d6", "d7", "d8", "d9", "d10"),
    *("t1", "peers"),
)
"""The modules, in the order of the report."""

"""``python -m benchmarks``, which :mod:`benchmarks.command` carries out."""

from __future__ import annotations

import sys

if __name__ == "__main__":
    try:
        # It imports PyTorch, which takes seconds.
        from benchmarks.command import main
    except KeyboardInterrupt:
        print("\nbenchmarks: stopped", file=sys.stderr)
        raise SystemExit(130) from None
    raise SystemExit(main())

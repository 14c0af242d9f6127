"""What a process that trains sets once, where it begins."""

from __future__ import annotations

import torch

# More than any machine has cores.
_MOST_THREADS = 4096


def prepare_process(threads: int = 1) -> None:
    """Set PyTorch up for small networks on few cores.

    Beside the threads: no distribution checks its arguments, which takes some percent of a training's time.

    Parameters
    ----------
    threads
        Threads of PyTorch; 0 leaves one per core.

    Raises
    ------
    ValueError
        If there can be no such number.
    """
    if not 0 <= threads <= _MOST_THREADS:
        raise ValueError(f"threads is {threads}; it must be 0 to {_MOST_THREADS}")
    if threads:
        torch.set_num_threads(threads)
    torch.distributions.Distribution.set_default_validate_args(False)

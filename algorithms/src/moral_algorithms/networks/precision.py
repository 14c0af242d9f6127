"""Half precision where the hardware multiplies it faster."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from functools import cache
from typing import Any

import torch

# Of processors that multiply bfloat16 matrices in hardware: Intel's tiles, and the vectors of several makers.
_INSTRUCTIONS = ("_is_amx_tile_supported", "_is_avx512_bf16_supported")


@cache
def has_fast_bfloat16(device_type: str) -> bool:
    """Whether bfloat16 matrix products are faster than float32 ones on a device of this type."""
    if device_type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    # The public interface tells nothing of the instructions; without the private questions, float32 it is.
    questions = (getattr(torch.cpu, name, None) for name in _INSTRUCTIONS)
    return device_type == "cpu" and any(question() for question in questions if question is not None)


def fast_matmul(device: torch.device) -> AbstractContextManager[Any]:
    """Context in which matrix products and convolutions run in bfloat16, if that is faster on ``device``."""
    if has_fast_bfloat16(device.type):
        return torch.autocast(device.type, torch.bfloat16)
    return nullcontext()

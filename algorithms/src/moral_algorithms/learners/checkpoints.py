"""The state of an optimiser as arrays, for checkpoints that load without executing anything."""

from __future__ import annotations

import torch

from moral_algorithms.storage import Arrays


def optimiser_state(optimiser: torch.optim.Optimizer) -> Arrays:
    """Copy what an optimiser has gathered: ``INDEX.NAME`` for each parameter and quantity."""
    return {
        f"{index}.{name}": tensor.detach().cpu().numpy().copy()
        for index, entries in optimiser.state_dict()["state"].items()
        for name, tensor in entries.items()
    }


def load_optimiser_state(optimiser: torch.optim.Optimizer, arrays: Arrays) -> None:
    """Continue from what :func:`optimiser_state` returned, for parameters of the same shapes.

    Raises
    ------
    IndexError, ValueError
        If the state is of other parameters.
    """
    parameters = [p for group in optimiser.param_groups for p in group["params"]]
    entries: dict[int, dict[str, torch.Tensor]] = {}
    for key, value in arrays.items():
        index, name = key.split(".", 1)
        tensor, parameter = torch.from_numpy(value.copy()), parameters[int(index)]
        if tensor.shape == parameter.shape:
            # The fused optimiser walks through memory: moments must lie there as their parameter does.
            tensor = torch.empty_like(parameter).copy_(tensor)
        entries.setdefault(int(index), {})[name] = tensor
    optimiser.load_state_dict({**optimiser.state_dict(), "state": entries})

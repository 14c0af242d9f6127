"""Adam without PyTorch's compiler does what PyTorch's does."""

from __future__ import annotations

import copy
import subprocess
import sys

import pytest
import torch

from moral_algorithms.networks.optimisers import EagerAdam, EagerAdamW

PAIRS = [(EagerAdam, torch.optim.Adam), (EagerAdamW, torch.optim.AdamW)]


def train(
    optimiser: type[torch.optim.Optimizer], steps: int
) -> tuple[torch.nn.Linear, torch.optim.Optimizer]:
    torch.manual_seed(0)
    layer = torch.nn.Linear(3, 2)
    one = optimiser(layer.parameters(), lr=0.1, weight_decay=0.3, fused=True)  # type: ignore[call-arg]
    for _ in range(steps):
        one.zero_grad()
        layer(torch.ones(4, 3)).square().sum().backward()
        one.step()
    return layer, one


@pytest.mark.parametrize(("ours", "theirs"), PAIRS)
def test_it_takes_the_same_steps(
    ours: type[torch.optim.Optimizer], theirs: type[torch.optim.Optimizer]
) -> None:
    (layer, one), (other_layer, other) = train(ours, 5), train(theirs, 5)
    assert torch.equal(layer.weight, other_layer.weight)
    assert layer.weight.grad is not None
    assert layer.weight.requires_grad
    # Each goes on from the other's state.
    states = [copy.deepcopy(optimiser.state_dict()) for optimiser in (one, other)]
    for optimiser, state in zip((other, one), states, strict=True):
        optimiser.load_state_dict(state)
        optimiser.step()
    assert torch.equal(layer.weight, other_layer.weight)


def test_gradients_are_forgotten() -> None:
    layer, optimiser = train(EagerAdam, 1)
    optimiser.zero_grad()
    assert all(parameter.grad is None for parameter in layer.parameters())


def test_a_closure_is_called_with_gradients() -> None:
    layer, optimiser = train(EagerAdam, 0)

    def loss() -> torch.Tensor:
        value: torch.Tensor = layer(torch.ones(1, 3)).square().sum()
        value.backward()  # type: ignore[no-untyped-call]
        return value

    before = layer.weight.detach().clone()
    told = optimiser.step(loss)  # type: ignore[arg-type, func-returns-value]
    assert told is not None
    assert not torch.equal(layer.weight, before)


TRAINING = """
import sys
from pathlib import Path
from tests.algorithms.cli.commands import AIRL, DEMONSTRATE, EXPERT, TRAIN, run
folder = Path(sys.argv[1])
expert, demonstrations, airl = folder / "expert", folder / "demonstrations.npz", folder / "airl"
assert run(*EXPERT, "--out", expert) == 0
assert run(*DEMONSTRATE, "--expert", expert, "--out", demonstrations) == 0
assert run(*AIRL, "--demonstrations", demonstrations, "--out", airl) == 0
assert run(*TRAIN, "--rewards", airl, "--out", folder / "moral") == 0
print("torch" in sys.modules, "torch._dynamo" in sys.modules)
"""


def test_no_command_waits_for_the_compiler(tmp_path: object) -> None:
    """The demo's commands have every optimiser and load every network."""
    done = subprocess.run(
        [sys.executable, "-c", TRAINING, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "True False"

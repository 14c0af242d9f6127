"""Episodes in as few bytes as it takes to play them again. NumPy only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Replay(NamedTuple):
    """An episode in as few bytes as it takes to play it again, in the same world with as many agents."""

    stream: int
    """State of the environment's random stream before the reset."""
    actions: NDArray[np.uint8]
    """Shape (T, n_agents)."""

    def to_json(self) -> dict[str, str]:
        """Write the stream in hexadecimal and one digit per action, agents of a step side by side."""
        return {"stream": f"{self.stream:016x}", "actions": "".join(map(str, self.actions.ravel().tolist()))}

    @classmethod
    def from_json(cls, value: dict[str, str], num_agents: int = 1) -> Replay:
        """Read what :meth:`to_json` wrote, of an episode of ``num_agents`` agents."""
        digits = np.array([int(digit) for digit in value["actions"]], dtype=np.uint8)
        return cls(int(value["stream"], 16), digits.reshape(-1, num_agents))

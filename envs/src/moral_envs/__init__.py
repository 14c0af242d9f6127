"""Grid worlds with vector rewards and ground-truth objective counters."""

import gymnasium

from moral_envs import (
    burning_warehouse_v0,
    delivery_v0,
    emergency_v0,
    layouts,
    noisy_constraint_v0,
    optimal,
    planning,
    windy_wall_v0,
)

__version__ = "0.1.0"
__all__ = [
    "burning_warehouse_v0",
    "delivery_v0",
    "emergency_v0",
    "layouts",
    "noisy_constraint_v0",
    "optimal",
    "planning",
    "windy_wall_v0",
]

for _name, _module in (
    ("Emergency", "emergency_v0"),
    ("BurningWarehouse", "burning_warehouse_v0"),
    ("Delivery", "delivery_v0"),
    ("WindyWall", "windy_wall_v0"),
    ("NoisyConstraint", "noisy_constraint_v0"),
):
    # The environment checker of `gymnasium.make` knows scalar rewards alone, hence off, as in MO-Gymnasium.
    gymnasium.register(
        id=f"moral/{_name}-v0",
        entry_point=f"moral_envs.{_module}:single_env",
        vector_entry_point=f"moral_envs.{_module}:vector_env",
        disable_env_checker=True,
    )

del _name, _module

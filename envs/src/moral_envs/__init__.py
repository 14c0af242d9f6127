"""Grid worlds with vector rewards and ground-truth objective counters."""

import gymnasium

from moral_envs import delivery_v0, emergency_v0

__version__ = "0.1.0"
__all__ = ["delivery_v0", "emergency_v0"]

for _name, _module in (("Emergency", "emergency_v0"), ("Delivery", "delivery_v0")):
    # The environment checker of `gymnasium.make` knows scalar rewards alone, hence off, as in MO-Gymnasium.
    gymnasium.register(
        id=f"moral/{_name}-v0",
        entry_point=f"moral_envs.{_module}:single_env",
        vector_entry_point=f"moral_envs.{_module}:vector_env",
        disable_env_checker=True,
    )

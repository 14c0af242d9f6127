"""The standard interfaces, each a thin face on :class:`moral_envs.engine.Engine`.

With the same seed and the same actions they all give the same trace.
"""

from moral_envs.faces.aec import GridAECEnv
from moral_envs.faces.factory import Faces
from moral_envs.faces.parallel import GridParallelEnv
from moral_envs.faces.single import GridEnv
from moral_envs.faces.vector import GridVectorEnv

__all__ = ["Faces", "GridAECEnv", "GridEnv", "GridParallelEnv", "GridVectorEnv"]

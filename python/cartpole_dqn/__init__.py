"""cartpole-dqn from Python: the policies that the program has trained, its metrics, and updates and loops for its `check`.

    from cartpole_dqn import Policy, Recorder, metrics, program, save_update, tensors

Only NumPy is needed. Nothing here imports PyTorch, Keras or JAX: `save_update` and `Recorder` take what these libraries have made.
"""

from __future__ import annotations

from ._policy import Policy
from ._program import program
from ._run import metrics
from ._tensors import tensors
from ._update import save_update
from .recorder import Recorder

__all__ = ["Policy", "Recorder", "metrics", "program", "save_update", "tensors"]

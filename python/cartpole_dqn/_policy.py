"""Policies that play without the program."""

from __future__ import annotations

import json
import re
from typing import Any, Optional, Union

import numpy as np

from . import _tensors
from ._run import PathLike, checkpoint_of, shown

MAX_LAYERS, MAX_UNITS = 64, 1 << 16
FORMAT_VERSION = 3
UNIT = 2.0**-24  # The largest relative error of one rounding to float32.


class Policy:
    """A greedy policy: the network or the table of Q-values that `cartpole-dqn` has trained, or a network of another program.

        policy = Policy("runs/mine")
        action, _ = policy.predict(observation)

    It takes the same actions as `cartpole-dqn eval`, from the same float32 arithmetic.

    Attributes:
        file: the file that was read, a `pathlib.Path`.
        environment: what the policy was trained in, such as "CartPole-v1"; None if the file does not say it.
        env_steps: environment steps of training before it; None if the file does not say it.
        observation_size: how many numbers an observation has.
        num_actions: how many actions there are; they are numbered from 0.
    """

    def __init__(self, path: PathLike) -> None:
        """Reads a policy.

        Args:
            path: the directory of a run (its best policy, else its last), or a .safetensors file: a checkpoint, or the state
                dict of a `torch.nn.Sequential` of Linear and ReLU.

        Raises ValueError if the file holds no policy or is damaged, OSError if it cannot be read.
        """
        self.file = checkpoint_of(path)
        arrays, metadata = _tensors.read(self.file)
        self.environment: Optional[str] = None
        self.env_steps: Optional[int] = None
        self._reward_scale = 1.0
        try:
            if _tensors.METADATA_KEY in metadata:
                self._read_header(metadata[_tensors.METADATA_KEY])
            self._q: Union[_Table, _Network] = _Table(arrays) if "q_table" in arrays else _Network(arrays)
        except ValueError as error:
            raise ValueError(f"{self.file}: {error}") from None
        self.observation_size: int = self._q.sizes[0]
        self.num_actions: int = self._q.sizes[1]

    def _read_header(self, text: str) -> None:
        header: dict[str, Any] = json.loads(text)
        if header.get("format_version") != FORMAT_VERSION:
            raise ValueError(f"format version {shown(header.get('format_version'))}; this module reads version {FORMAT_VERSION}")
        config = header.get("config") or {}
        environment = config.get("environment", "CartPole-v1")
        self.environment = environment if isinstance(environment, str) else None
        self.env_steps = header.get("env_steps")
        self._reward_scale = float(config.get("reward_scale", 1.0))

    def predict(
        self,
        observation: Any,
        state: Optional[tuple[np.ndarray, ...]] = None,
        episode_start: Optional[np.ndarray] = None,
        deterministic: bool = True,
    ) -> tuple[Any, None]:
        """The action with the largest Q-value, the first of equals. The signature is that of Stable-Baselines3's models, so
        that its `evaluate_policy(policy, env)` takes a policy.

        Args:
            observation: of shape (n,), or a batch of shape (B, n). In the units of the environment, rounded to float32.
            state: not used: there is no recurrent state.
            episode_start: not used.
            deterministic: not used: the policy never explores.

        Returns (action, None): a `numpy.int64`, or for a batch an array of shape (B,).

        Raises ValueError for another shape, or numbers that are not finite.
        """
        batch, is_one = self._batch(observation)
        actions = self._q.actions(batch)
        return (actions[0] if is_one else actions), None

    def q_values(self, observation: Any) -> np.ndarray:
        """The Q-values: discounted returns that the policy expects of each action, in units of the environment's rewards.

        Args:
            observation: of shape (n,), or a batch of shape (B, n).

        Returns float32 of shape (actions,), or for a batch (B, actions).
        """
        batch, is_one = self._batch(observation)
        values = (self._q.values(batch).astype(np.float64) / self._reward_scale).astype(np.float32)
        return values[0] if is_one else values

    def _batch(self, observation: Any) -> tuple[np.ndarray, bool]:
        """Observations (B, n) in float32, and whether it was a single one."""
        array = np.asarray(observation)
        n = self.observation_size
        if array.dtype.kind not in "fiub" or array.ndim not in (1, 2) or array.shape[-1] != n:
            raise ValueError(
                f"an observation has the shape ({n},), a batch of them (B, {n}), both of numbers; found {array.shape} of {array.dtype}"
            )
        array = array.astype(np.float32)
        if not np.isfinite(array).all():
            raise ValueError("the observation holds NaN, infinity, or a number beyond float32")
        return array.reshape(-1, n), array.ndim == 1

    def __repr__(self) -> str:
        return f"Policy({str(self.file)!r}): {self._q}"


class _Table:
    """Q-values of the cells of a grid. An observation belongs to cell k of a coordinate if k edges are not above it."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self.table = _floats(arrays, "q_table")
        if self.table.ndim < 2 or 0 in self.table.shape:
            raise ValueError(f"its `q_table` has the shape {self.table.shape}, expected (cells of each coordinate …, actions)")
        self.edges = [_floats(arrays, f"table.edges.{k}") for k in range(self.table.ndim - 1)]
        for k, edges in enumerate(self.edges):
            if edges.shape != (self.table.shape[k] - 1,) or not (np.diff(edges) > 0).all():
                raise ValueError(f"tensor `table.edges.{k}` must be {self.table.shape[k] - 1} numbers that ascend")
        self.sizes = (self.table.ndim - 1, self.table.shape[-1])

    def values(self, batch: np.ndarray) -> np.ndarray:
        """(B, n) -> (B, actions)"""
        values: np.ndarray = self.table[tuple(np.searchsorted(edges, x, side="right") for edges, x in zip(self.edges, batch.T))]
        return values

    def actions(self, batch: np.ndarray) -> np.ndarray:
        """(B, n) -> (B,)"""
        best: np.ndarray = np.argmax(self.values(batch), axis=1)
        return best

    def __str__(self) -> str:
        return f"a table of {self.table.shape[:-1]} cells with {self.sizes[1]} actions"


class _Network:
    """Dense layers with ReLU between them."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self.layers = _layers(_as_sequential(arrays) or arrays)
        # For `actions`: the same weights in float64, and their absolute values.
        wide = [(weight.astype(np.float64), bias.astype(np.float64)) for weight, bias in self.layers]
        self.wide = [(weight, bias, np.abs(weight), np.abs(bias)) for weight, bias in wide]
        self.sizes = (self.layers[0][0].shape[1], self.layers[-1][0].shape[0])

    def values(self, batch: np.ndarray) -> np.ndarray:
        """(B, n) -> (B, actions), to the last bit as the program has them: each sum begins at the bias, and every product is
        added by a fused multiply-add in the order of the inputs. A product of two float32 is exact in float64."""
        x = batch.T
        for layer, (weight, bias) in enumerate(self.layers):
            y = np.broadcast_to(bias[:, None], (len(bias), x.shape[1]))
            for column, row in zip(weight.T, x):
                y = (np.multiply.outer(column, row, dtype=np.float64) + y).astype(np.float32)
            x = np.maximum(y, np.float32(0)) if layer < len(self.layers) - 1 else y
        return x.T

    def actions(self, batch: np.ndarray) -> np.ndarray:
        """(B, n) -> (B,): the argmax of `values`. Matrix products in float64 with a bound of what rounding to float32 may change
        tell it for most observations; only where the bound leaves two actions open are `values` computed, which takes longer.

        A sum of n fused steps in float32 is wrong by at most γ (|b| + |W| |x|), γ = n u / (1 − n u) (Higham 2002, section 3.1).
        """
        x, error = batch.T.astype(np.float64), np.zeros(batch.T.shape)
        for layer, (weight, bias, weight_size, bias_size) in enumerate(self.wide):
            n = weight.shape[1]
            gamma = 1.01 * n * UNIT / (1 - n * UNIT)  # 1.01: this bound is rounded too.
            size = bias_size[:, None] + weight_size @ (np.abs(x) + error)
            # 1e-40: the products that are too small for float32. Sums that are too large for it leave everything open.
            error = np.where(size < 1e38, weight_size @ error + gamma * size + 1e-40, np.inf)
            x = weight @ x + bias[:, None]
            x = np.maximum(x, 0) if layer < len(self.wide) - 1 else x
        best: np.ndarray = np.argmax(x, axis=0)
        columns = np.arange(x.shape[1])
        # Not `>=`: an infinite error leaves NaN, and no comparison with NaN holds.
        is_open = ~(x + error < (x - error)[best, columns])
        is_open[best, columns] = False
        unsure = is_open.any(axis=0)
        if unsure.any():
            best[unsure] = self.values(batch[unsure]).argmax(axis=1)
        return best

    def __str__(self) -> str:
        return f"layers {[self.sizes[0], *(len(bias) for _, bias in self.layers)]}"


def _as_sequential(arrays: dict[str, np.ndarray]) -> Optional[dict[str, np.ndarray]]:
    """The tensors of another program under the names of a `torch.nn.Sequential`, if there is one way to read them: layers whose
    names differ by their numbers alone, as `q_net.0.weight`, `q_net.2.weight`, or `layer1.weight`, `layer2.weight`. Behind a dot
    an activation takes a number too."""
    chains: dict[str, dict[int, str]] = {}
    for name in arrays:
        parts = re.fullmatch(r"((.*?)([0-9]{1,9}))\.(?:weight|bias)", name, re.DOTALL)
        if not parts:
            return None
        chains.setdefault(parts[2], {})[int(parts[3])] = parts[1]
    if len(chains) > 1:
        chains = {prefix: layers for prefix, layers in chains.items() if "target" not in prefix}
    if len(chains) != 1:
        return None
    ((prefix, layers),) = chains.items()
    step = 2 if prefix == "" or prefix.endswith(".") else 1
    numbers = sorted(layers)
    if numbers != list(range(numbers[0], numbers[0] + step * len(numbers), step)):
        return None
    renamed = {}
    for index, number in enumerate(numbers):
        for kind in ("weight", "bias"):
            if f"{layers[number]}.{kind}" not in arrays:
                return None
            array = arrays[f"{layers[number]}.{kind}"]
            renamed[f"{2 * index}.{kind}"] = array.astype(np.float32) if array.dtype == np.float64 else array
    return renamed


def _layers(arrays: dict[str, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Weight (out, in) and bias (out) of every layer, from the tensors whose names start with a digit."""
    layers: list[tuple[np.ndarray, np.ndarray]] = []
    while f"{2 * len(layers)}.weight" in arrays and len(layers) < MAX_LAYERS:
        name = f"{2 * len(layers)}"
        weight, bias = _floats(arrays, f"{name}.weight"), _floats(arrays, f"{name}.bias")
        expected = len(layers[-1][1]) if layers else (weight.shape[1] if weight.ndim == 2 else 0)
        if weight.ndim != 2 or weight.shape[1] != expected or not all(1 <= size <= MAX_UNITS for size in weight.shape):
            raise ValueError(f"tensor `{name}.weight` has the shape {weight.shape}, expected (1 to {MAX_UNITS}, {expected or 'in'})")
        if bias.shape != weight.shape[:1]:
            raise ValueError(f"tensor `{name}.bias` has the shape {bias.shape}, expected ({weight.shape[0]},)")
        layers.append((weight, bias))
    if not layers or sum(name[:1] in tuple("0123456789") for name in arrays) != 2 * len(layers):
        raise ValueError(
            "it holds no policy: the tensors whose names start with a digit must be exactly 0.weight, 0.bias, 2.weight, …, as of a "
            "torch.nn.Sequential of Linear and ReLU, or there must be a q_table"
        )
    return layers


def _floats(arrays: dict[str, np.ndarray], name: str) -> np.ndarray:
    """A tensor of finite float32."""
    if name not in arrays:
        raise ValueError(f"it has no tensor `{name}`")
    if arrays[name].dtype != np.float32:
        raise ValueError(f"tensor `{name}` is {arrays[name].dtype}, expected float32")
    if not np.isfinite(arrays[name]).all():
        raise ValueError(f"tensor `{name}` holds NaN or infinity")
    return arrays[name]

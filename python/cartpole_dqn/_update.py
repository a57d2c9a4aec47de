"""Writing one update of somebody's own DQN for `cartpole-dqn check`.

The libraries are known by what their objects have, and none of them is imported.
"""

from __future__ import annotations

import json
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Optional, Union

import numpy as np

from . import _tensors
from ._run import PathLike, shown

NEEDED = ("observations", "actions", "rewards", "next_observations", "terminated")
OPTIONAL = ("truncated", "discounts", "weights")
RESULTS = ("targets", "loss", "gradients", "online", "q", "target")
NETWORKS = ("gradients", "online", "target")
SETTINGS = (
    "gamma", "loss", "double", "learning_rate", "beta1", "beta2", "epsilon", "epsilon_place", "max_gradient_norm",
    "clip_value", "huber_delta", "optimizer_name", "weight_decay", "amsgrad", "momentum", "alpha", "environment",
)  # fmt: skip


def save_update(
    path: PathLike,
    online: Any,
    target: Any,
    optimizer: Any,
    batch: Mapping[str, Any],
    update: Union[Mapping[str, Any], Callable[[], Any]],
    *,
    forward: Optional[Callable[[Any, Any], Any]] = None,
    **settings: Any,
) -> None:
    """Runs one update of your DQN and writes it to a file, of which `cartpole-dqn check FILE` says what mistake it has.

    Call it once, in place of the update. Take an update after some learning, with terminated (and truncated) rows in its batch.

    Args:
        path: the file to write. Its name should end in .safetensors.
        online: the network that learns, of dense layers with ReLU between them, before the update:

            - PyTorch: the module; or its state dict, or its list of parameters (weights [out, in]);
            - Keras: the model (kernels [in, out]);
            - JAX: the tree of its parameters, of any kind, with kernels [in, out];
            - NumPy: the list W0, b0, W1, b1, … with W [in, out], as in `x @ W + b`.
        target: the target network in the same form, or None if the online network values s′.
        optimizer: before the update: the optimizer of PyTorch or Keras, the state of optax, or `(steps, m, v)` with Adam's
            moments in the form of the network. None before the first step.
        batch: the B transitions: `observations` and `next_observations` [B, n], as the network gets them; `actions` [B], from
            0; `rewards` [B]; `terminated` [B]; `truncated` [B], only if your memory stores it; `discounts` [B], γᵏ of samples of k
            steps.
        update: a function without arguments that does the update and returns `(targets, loss)`, `(targets, loss, gradients)`,
            or `(targets, loss, gradients, online)`, each None where you do not have it; or a mapping with any of these names,
            or a function that returns one. `targets` [B]; `loss` one number; `gradients` as the optimizer gets them (clipped);
            `online` the network after the step; a mapping also `q` [B, actions], what the network said before the step, and `target`,
            the target network after it. What a function does not return of gradients and networks of modules of PyTorch,
            or of networks of models of Keras, is read from there: it must then not call `zero_grad` at its end.
        forward: a function of (online, observations) that returns Q(s, ·) [B, actions], as `apply` of Flax. Modules of PyTorch and
            models of Keras are asked without it, before the update: without dropout, gradients and random numbers.
        settings: how the update should be computed: gamma (0.99), loss ("mse" or "huber"), double (False), learning_rate
            (0.001), beta1 (0.9), beta2 (0.999), epsilon (1e-8; for Keras 1e-7), epsilon_place ("pytorch"; for Keras
            "tensorflow"), max_gradient_norm (none), clip_value (none), huber_delta (1), environment; and, where PyTorch's
            optimizer does not say them itself, optimizer_name ("adam", "adamw", "rmsprop", "sgd"), weight_decay, amsgrad, momentum, alpha.

    Raises ValueError, and writes nothing, if something is missing or not of the form that is said here; before the update,
    except for what the update returns.
    """
    unknown = [name for name in settings if name not in SETTINGS]
    if unknown:
        raise ValueError(f"there is no setting {shown(unknown[0])}; the settings are {', '.join(SETTINGS)}")
    if _is_keras(online):
        settings = {"epsilon": 1e-7, "epsilon_place": "tensorflow", **settings}
    has_known_step = True
    try:
        settings = {**_optimizer_settings(optimizer), **settings}
    except ValueError as error:
        has_known_step = "optimizer_name" in settings
        if not has_known_step:
            warnings.warn(f"the step of the optimizer is left out: {error}. The rest of the update is written", stacklevel=2)
    if "optimizer_name" in settings:
        settings["optimizer"] = settings.pop("optimizer_name")
    text = json.dumps(settings, default=_number)
    file = _network("online", online)
    shapes = {name.partition(".")[2]: array.shape for name, array in file.items()}
    if target is not None:
        file.update(_network("target", target, shapes))
    moments = _adam(optimizer, online) if has_known_step else None
    if moments is not None:
        steps, first, second = moments
        file["adam.steps"] = np.array([steps], dtype=np.int64)
        file.update(_network("adam.m", first, shapes))
        file.update(_network("adam.v", second, shapes))
    for name, values in _other_moments(optimizer, online).items() if has_known_step else ():
        file.update(_network(name, values, shapes))
    file.update(_batch(batch, shapes["0.weight"][1]))
    if _is_torch(online):
        before = [parameter.grad for parameter in online.parameters()]
        if all(gradient is not None for gradient in before):
            file.update(_network("before.gradients", before, shapes))
    q = None
    if callable(update) or forward is not None:
        q = _q_values(online, forward, file["batch.observations"], actions=list(shapes.values())[-1][0])
    results = _with_own(update(), online, target) if callable(update) else _named(update)
    results["q"] = q if results.get("q") is None else results["q"]
    results["online"] = results.get("online") if has_known_step else None
    file.update(_results(results, shapes))
    _tensors.write(path, file, {"settings": text})


def _batch(batch: Mapping[str, Any], observation_size: int) -> dict[str, np.ndarray]:
    missing = [name for name in NEEDED if batch.get(name) is None]
    if missing:
        raise ValueError(f"the batch has no {missing[0]!r}; it must have {', '.join(NEEDED)}")
    unknown = [name for name in batch if name not in NEEDED + OPTIONAL]
    if unknown:
        raise ValueError(f"the batch has {shown(unknown[0])}; allowed are {', '.join(NEEDED + OPTIONAL)}")
    arrays = {name: _array(value) for name, value in batch.items() if value is not None}
    size = len(arrays["observations"]) if arrays["observations"].ndim else 0
    for name, array in arrays.items():
        shape = (size, observation_size) if name.endswith("observations") else (size,)
        # Columns [B, 1] are as good as lists [B].
        if array.shape[: len(shape)] != shape or array[:1].size != np.prod(shape[1:], dtype=int) or size == 0:
            raise ValueError(
                f"{name!r} of the batch has the shape {array.shape}, expected {shape}: B transitions, and observations as long as "
                f"the first weight has inputs, {observation_size}"
            )
    return {f"batch.{name}": array for name, array in arrays.items()}


def _with_own(given: Any, online: Any, target: Any) -> dict[str, Any]:
    """The results of an update, and what its networks show of them after it."""
    results = _named(given)
    if _is_torch(online) and results.get("gradients") is None:
        gradients = [parameter.grad for parameter in online.parameters()]
        results["gradients"] = None if any(gradient is None for gradient in gradients) else gradients
    for name, network in (("online", online), ("target", target)):
        if (_is_torch(network) or _is_keras(network)) and results.get(name) is None:
            results[name] = network
    return results


def _q_values(online: Any, forward: Optional[Callable[..., Any]], observations: np.ndarray, actions: int) -> Optional[np.ndarray]:
    """Q(s, ·) [B, actions], as the network says it when nothing is learned; None of a network that does not say it so."""
    shape = (len(observations), actions)
    if forward is not None:
        q = _array(forward(online, observations.copy()))
        if q.shape != shape:
            raise ValueError(f"`forward` returned the shape {q.shape}, expected {shape}: the Q-values of all actions of each observation")
        return q
    try:
        q = _asked(online, observations)
        # Half precision is no mistake of the network.
        is_exact = str(getattr(q, "dtype", "")).endswith(("float32", "float64"))
        return _array(q) if is_exact and tuple(q.shape) == shape else None
    except Exception:  # It may want another form of observations, and the update is to be done all the same.
        return None


def _asked(online: Any, observations: np.ndarray) -> Any:
    """What a module of PyTorch or a model of Keras says, with the module left as it was: `eval` and `train` may do more."""
    if _is_keras(online):
        return online(observations if observations.dtype.kind == "f" else observations.astype(np.float32), training=False)
    if not _is_torch(online) or not callable(online):
        return None
    torch = sys.modules["torch"]
    weight = next(online.parameters())
    modes = [(module, module.training) for module in online.modules()]
    try:
        for module, _ in modes:
            module.training = False
        with torch.no_grad(), torch.random.fork_rng([weight.device] if weight.is_cuda else []):
            return online(torch.tensor(observations, dtype=weight.dtype, device=weight.device))
    finally:
        for module, was_training in modes:
            module.training = was_training


def _named(given: Any) -> dict[str, Any]:
    if isinstance(given, Mapping):
        unknown = [name for name in given if name not in RESULTS]
        if unknown:
            raise ValueError(f"the results have {shown(unknown[0])}; allowed are {', '.join(RESULTS)}")
        return dict(given)
    if isinstance(given, (tuple, list)) and 2 <= len(given) <= 4:
        return dict(zip(RESULTS, given))
    raise ValueError(
        f"the update must return (targets, loss), (targets, loss, gradients) or (targets, loss, gradients, online), or a "
        f"mapping with these names; found {type(given).__name__}"
    )


def _results(given: Any, shapes: dict[str, tuple[int, ...]]) -> dict[str, np.ndarray]:
    results = _named(given)
    file: dict[str, np.ndarray] = {}
    for name, value in results.items():
        if value is None:
            continue
        if name in NETWORKS:
            file.update(_network(f"result.{name}", value, shapes))
        else:
            file[f"result.{name}"] = _array(value)
    if not file:
        raise ValueError(f"the update returned nothing of {', '.join(RESULTS)}")
    return file


def _adam(optimizer: Any, online: Any) -> Optional[tuple[int, Any, Any]]:
    """The steps of Adam so far, and its moments; None before the first step, and for optimizers without moments."""
    if optimizer is None:
        return None
    if hasattr(optimizer, "param_groups"):  # PyTorch
        if _is_torch(online):
            parameters = list(online.parameters())
        else:
            parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        states = [optimizer.state[p] for p in parameters if "exp_avg" in optimizer.state.get(p, {})]
        if not states:
            return None
        return int(states[0]["step"]), [s["exp_avg"] for s in states], [s["exp_avg_sq"] for s in states]
    if hasattr(optimizer, "iterations"):  # Keras
        steps, moments = int(_array(optimizer.iterations)), getattr(optimizer, "_momentums", None)
        return (steps, moments, optimizer._velocities) if steps > 0 and moments else None
    if isinstance(optimizer, (tuple, list)) and len(optimizer) == 3 and _is_scalar(optimizer[0]):
        steps, first, second = optimizer
        return (int(_array(steps)), first, second) if int(_array(steps)) > 0 else None
    if hasattr(optimizer, "init") or not isinstance(optimizer, (tuple, list, Mapping)):
        raise ValueError(
            f"the optimizer is {type(optimizer).__name__}; it must be an optimizer of PyTorch or Keras, the state that `init` and "
            "`update` of optax return, (steps, m, v), or None before the first step"
        )
    found = next((state for state in _walk(optimizer) if hasattr(state, "mu") and hasattr(state, "nu")), None)
    return None if found is None or int(_array(found.count)) == 0 else (int(_array(found.count)), found.mu, found.nu)


def _optimizer_settings(optimizer: Any) -> dict[str, Any]:
    """What an optimizer of PyTorch says of itself; of others nothing. Raises ValueError with the reason if its step is another one
    than those that `check` computes."""
    groups = getattr(optimizer, "param_groups", None)
    if not groups:
        return {}
    kinds = {"Adam": "adam", "AdamW": "adamw", "RMSprop": "rmsprop", "SGD": "sgd"}
    kind = kinds.get(type(optimizer).__name__)
    if kind is None:
        raise ValueError(f"it is {type(optimizer).__name__}, and `check` knows {', '.join(kinds)}")
    names = {"learning_rate": "lr", "epsilon": "eps", "weight_decay": "weight_decay", "amsgrad": "amsgrad", "momentum": "momentum", "alpha": "alpha"}
    others = ("nesterov", "dampening", "centered", "maximize")
    for group in groups:
        set_ones = [name for name in others if group.get(name)]
        if set_ones:
            raise ValueError(f"`check` knows no {set_ones[0]}")
        if any(group.get(name) != groups[0].get(name) for name in (*names.values(), "betas")):
            raise ValueError("its groups of parameters have different settings")
    group = groups[0]
    settings = {name: group[own] for name, own in names.items() if own in group}
    settings |= dict(zip(("beta1", "beta2"), group.get("betas", ())))
    settings = {name: value if isinstance(value, bool) else float(value) for name, value in settings.items()}
    return {"optimizer": "adamw" if group.get("decoupled_weight_decay") else kind, **settings}


def _other_moments(optimizer: Any, online: Any) -> dict[str, list[Any]]:
    """What optimizers of PyTorch remember besides Adam's moments, if it is there of all parameters."""
    if not hasattr(optimizer, "param_groups") or not _is_torch(online):
        return {}
    states = [optimizer.state.get(parameter, {}) for parameter in online.parameters()]
    names = {"adam.vmax": "max_exp_avg_sq", "adam.m": "momentum_buffer", "adam.v": "square_avg"}
    return {name: [state[own] for state in states] for name, own in names.items() if all(state.get(own) is not None for state in states)}


def _walk(state: Any) -> Iterator[Any]:
    """A state of optax and all states within it."""
    yield state
    if isinstance(state, Mapping):
        state = list(state.values())
    if isinstance(state, (tuple, list)):
        for inner in state:
            yield from _walk(inner)


def _network(prefix: str, network: Any, shapes: Optional[dict[str, tuple[int, ...]]] = None) -> dict[str, np.ndarray]:
    """`{prefix}.0.weight` [out, in], `{prefix}.0.bias` [out], `{prefix}.2.weight`, …: the nth matrix and the nth vector of the
    network belong to its nth layer. `shapes` are those of the online network."""
    leaves = [(name, _array(leaf), _is_out_in(name, leaf)) for name, leaf in _leaves(network)]
    weights = [array if is_out_in else array.T for _, array, is_out_in in leaves if array.ndim == 2]
    biases = [array for _, array, _ in leaves if array.ndim == 1]
    found = ", ".join(f"{name or 'array'} {array.shape}" for name, array, _ in leaves[:12]) or f"no array in {type(network).__name__}"
    if not weights or len(weights) != len(biases) or len(leaves) != 2 * len(weights):
        raise ValueError(f"{prefix} must be dense layers, each with a weight and a bias; found {shown(found)}")
    inputs = weights[0].shape[1]
    for weight, bias in zip(weights, biases):
        if weight.shape != (len(bias), inputs):
            raise ValueError(
                f"{prefix}: the layers do not fit to each other: a weight has {weight.shape[1]} inputs and {weight.shape[0]} outputs where "
                f"{inputs} and {len(bias)} are needed. Give them in the order of the layers, arrays as [in, out], tensors of PyTorch as "
                f"[out, in]; found {shown(found)}"
            )
        inputs = len(bias)
    file = {}
    for layer, (weight, bias) in enumerate(zip(weights, biases)):
        file.update({f"{2 * layer}.weight": weight, f"{2 * layer}.bias": bias})
    own = {name: array.shape for name, array in file.items()}
    if shapes is not None and own != shapes:
        raise ValueError(f"{prefix} has the layers {shown(own)}, the online network has {shown(shapes)}")
    return {f"{prefix}.{name}": array for name, array in file.items()}


def _leaves(tree: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """The arrays of a network, with their names where they have one, in the order of the layers."""
    if _is_torch(tree):
        yield from tree.named_parameters()
    elif _is_keras(tree):
        yield from ((str(variable.name), variable) for variable in tree.weights)
    elif isinstance(tree, Mapping):
        # PyTorch's names have the order of the layers. JAX sorts, where Dense_10 must come behind Dense_2.
        is_ordered = any(_is_out_in(key, value) for key, value in tree.items())
        for key in tree if is_ordered else sorted(tree, key=_natural):
            yield from _leaves(tree[key], f"{name}.{key}" if name else str(key))
    elif isinstance(tree, (tuple, list)):
        for inner in tree:
            yield from _leaves(inner, name)
    elif tree is not None:
        yield name, tree


def _natural(key: Any) -> list[tuple[str, int]]:
    """A sort key of names with numbers in them."""
    return [(text, int(digits or 0)) for text, digits in re.findall(r"([^0-9]*)([0-9]{0,9})", str(key))]


def _is_torch(network: Any) -> bool:
    # A model of Keras on PyTorch is a module too, with weights [in, out].
    return hasattr(network, "named_parameters") and hasattr(network, "state_dict") and not _is_keras(network)


def _is_keras(network: Any) -> bool:
    return hasattr(network, "trainable_variables") and hasattr(network, "weights")


def _is_out_in(name: Any, leaf: Any) -> bool:
    """Whether a weight is [out, in]: a tensor of PyTorch, or an array under a name that PyTorch gives it."""
    return type(leaf).__module__.partition(".")[0] == "torch" or str(name).endswith(".weight")


def _is_scalar(value: Any) -> bool:
    return np.isscalar(value) or getattr(value, "shape", None) == ()


def _array(value: Any) -> np.ndarray:
    """A copy as a NumPy array of a type that `check` reads."""
    if hasattr(value, "detach"):  # PyTorch, where only a tensor of numbers that NumPy has can become an array
        value = value.detach().cpu()
        value = value.float() if str(value.dtype) in ("torch.bfloat16", "torch.float16") else value
    if hasattr(value, "numpy"):  # PyTorch, TensorFlow, Keras
        value = value.numpy()
    try:
        array = np.array(value)
    except ValueError as error:
        raise ValueError(f"{shown(value)} is no array of numbers ({error})") from None
    if array.dtype in _tensors.NAMES and array.dtype != np.float16:
        return array
    if array.dtype.kind in "OSUMmVc" and array.dtype.name != "bfloat16":
        raise ValueError(f"{shown(value)} is no array of numbers")
    return array.astype(np.float32)


def _number(value: Any) -> Any:
    """What JSON gets of a setting that is a number of NumPy or of another library."""
    if hasattr(value, "item"):
        return value.item()
    raise ValueError(f"a setting is {shown(value)}, expected a number or a text")

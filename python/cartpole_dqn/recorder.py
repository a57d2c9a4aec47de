"""Recording a whole DQN loop for `cartpole-dqn check`. docs/check.md describes the file.

The libraries are known by what their objects have, and none of them is imported.
"""

from __future__ import annotations

import atexit
import json
import math
import os
import sys
import zlib
from collections.abc import Callable, Mapping
from typing import Any, Optional

import numpy as np

from . import _tensors
from ._run import PathLike, shown
from ._update import (
    NEEDED, OPTIONAL, SETTINGS, _adam, _array, _is_keras, _is_torch, _leaves, _network, _number, _optimizer_settings,
    _other_moments, _q_values,
)  # fmt: skip

VERSION = 1
MAX_STEPS = 1 << 20  # Environment steps in one file, and updates.
MAX_NUMBERS = 1 << 23  # Numbers in all observations.
MAX_OBSERVATION = 4096
MAX_BATCHES, MAX_ROWS = 200, 1 << 15  # Minibatches, and their rows.
MAX_UPDATES, MAX_WEIGHTS = 8, 1 << 20  # Whole updates, and the weights of a network in them.
CHECKSUM_BYTES = 2048  # A checksum covers as many bytes at either end of a tensor.
ENOUGH_SHARED = 20  # Updates in turn after which online and target network are one object.
SAMPLES = 16  # Weights of each network that are written down at every update.
FIRST_WRITE = 2000  # Steps and updates after which the file is written for the first time.


class Recorder:
    """Writes down what a DQN loop does, for `cartpole-dqn check FILE`.

        recorder = Recorder("dqn.trace", gamma=0.99, loss="huber", learning_rate=1e-3)
        env = recorder.environment(env)
        ...
        recorder.learned(online=q_net, target=target_net, batch=batch, targets=y, loss=loss)    # after each update

    It never raises, and changes no array and no random number of yours. What it cannot record it says once on standard error.
    The file is written whole, by `close`, at exit, and now and then in between.
    """

    def __init__(self, path: PathLike, **settings: Any) -> None:
        """Args:
        path: the file to write.
        settings: those of `save_update`, as far as they do not change during the run, and `environment`, the name of the task,
            where the environment does not say it.
        """
        self._path = os.fspath(path)
        self._said: dict[str, str] = {}
        self._settings: dict[str, Any] = {}
        for name, value in settings.items():
            try:
                if name not in (*SETTINGS, "environment"):
                    raise ValueError(f"there is none of that name, only {', '.join(SETTINGS)}, environment")
                own = "optimizer" if name == "optimizer_name" else name
                self._settings[own] = json.loads(json.dumps(value, default=_number))
            except (TypeError, ValueError) as error:
                self._say(f"setting {shown(name)}: {error}")
        self._environments: list[_Environment] = []
        self._steps = _Table(MAX_STEPS)
        self._updates = _Table(MAX_STEPS)
        self._acting: tuple[Any, Any] = (None, None)
        self._learning = _Learning()
        self._none_told = np.empty(0, np.float32)
        self._next_write = FIRST_WRITE
        self._is_open = True
        atexit.register(self.close)

    def environment(self, env: Any) -> Any:
        """The same environment, single or a vector of several, which writes down what `reset` and `step` really say."""
        recorded = _Environment(env, self, sum(other._count for other in self._environments))
        self._environments.append(recorded)
        return recorded

    def acting(self, q_values: Any = None, epsilon: Any = None) -> None:
        """Before `env.step`: the Q-values [actions] of the observation (or [environments, actions]), and the ε in force."""
        self._try("acting", self._keep_acting, q_values, epsilon)

    def learned(
        self,
        online: Any,
        target: Any = None,
        batch: Optional[Mapping[str, Any]] = None,
        targets: Any = None,
        loss: Any = None,
        optimizer: Any = None,
    ) -> None:
        """After each update.

        Args:
            online: the network that learns, in one of the forms that `save_update` takes.
            target: the target network, in the same form; None if there is none.
            batch: the minibatch, with the names of `save_update`.
            targets: the TD targets [B].
            loss: one number.
            optimizer: as for `save_update`, after the update: then the step of the weights can be judged too.
        """
        self._try("learned", self._keep_update, online, target, batch, targets, loss, optimizer)

    def close(self) -> None:
        """Writes the file. What comes afterwards is not recorded."""
        if self._is_open:
            self._try("close", self._write, True)
            self._is_open = False
            atexit.unregister(self.close)

    def _try(self, part: str, function: Callable[..., None], *arguments: Any) -> None:
        """Calls a function, of which no error comes out."""
        if not self._is_open:
            return
        try:
            function(*arguments)
        except Exception as error:  # It must not end somebody's training.
            self._say(f"{part}: {error}", part)

    def _say(self, message: str, kind: str = "") -> None:
        """Says what is not recorded, once of a kind."""
        kind = kind or message
        if kind in self._said:
            return
        self._said[kind] = message[:300]
        try:
            print(f"cartpole_dqn.Recorder: not recorded: {message[:300]}", file=sys.stderr)
        except (OSError, ValueError):
            pass

    def _keep_acting(self, q_values: Any, epsilon: Any) -> None:
        q = None if q_values is None else np.array(_numbers(q_values), np.float32)
        self._acting = (q, None if epsilon is None else _number_of(epsilon))

    def _keep_steps(self, before: np.ndarray, after: np.ndarray, place: Optional[np.ndarray], *columns: Any) -> None:
        """Writes down a step: of one environment, or of those of a vector at these places, with a row for each. The columns are
        action, reward, terminated, truncated, whether a reset came before, and which environment it is."""
        (q, epsilon), self._acting = self._acting, (None, None)
        if not self._steps.fields:
            size, actions = before.shape[-1], self._num_actions() or (0 if q is None else q.shape[-1])
            if size > MAX_OBSERVATION:
                raise ValueError(f"observations of {size} numbers; at most {MAX_OBSERVATION}")
            self._steps.limit = min(MAX_STEPS, MAX_NUMBERS // (2 * size + actions))
            self._none_told = np.full(actions, np.nan, np.float32)
            self._steps.begin(
                [
                    ("observation", "f4", (size,)), ("next_observation", "f4", (size,)), ("action", "i4"), ("reward", "f8"),
                    ("terminated", "?"), ("truncated", "?"), ("reset", "u1"), ("environment", "u4"), ("q_values", "f4", (actions,)),
                    ("epsilon", "f4"),
                ]
            )  # fmt: skip
        if before.shape[-1:] != self._steps.fields["observation"]:
            raise ValueError(f"observations of {before.shape[-1]} numbers after those of {self._steps.fields['observation'][0]}")
        actions = len(self._none_told)
        chosen = self._none_told
        if q is not None and q.size == actions:
            chosen = q.reshape(actions)
        elif q is not None and place is not None and q.ndim == 2 and q.shape[1] == actions and len(q) > place[-1]:
            chosen = q[place]
        elif q is not None:
            self._say(f"Q-values of shape {q.shape}, expected ({actions},) or (environments, {actions})")
        row = (before, after, *columns, chosen, np.nan if epsilon is None else epsilon)
        if not self._steps.append(row, None if place is None else len(place)):
            self._say(f"steps and updates after step {len(self._steps)}, which is as much as a file holds", "full")
        self._write_now_and_then()

    def _num_actions(self) -> int:
        env = self._environments[-1]
        space = getattr(env, "single_action_space", None) or getattr(env, "action_space", None)
        return int(getattr(space, "n", 0))

    def _keep_update(self, online: Any, target: Any, batch: Any, targets: Any, loss: Any, optimizer: Any) -> None:
        if self._steps.is_full:
            return
        learning, steps = self._learning, len(self._steps)
        if target is None:
            self._say("a target network: `learned` was given none", "target")
        # Where arrays never change, as in JAX, a copy is the same object until the next update.
        learning.shared = learning.shared + 1 if target is online else 0
        learning.same_object |= learning.shared >= ENOUGH_SHARED
        if _is_keras(online) and not self._updates.fields:
            self._settings.setdefault("epsilon", 1e-7)
            self._settings.setdefault("epsilon_place", "tensorflow")
        networks = [learning.fingerprint("online", online), None if target is None else learning.fingerprint("target", target)]
        if not self._updates.fields:
            checksums, samples = ("u4", (2,)), ("f4", (len(networks[0][1]),))
            self._updates.begin(
                [
                    ("step", "i8"), ("online", *checksums), ("target", *checksums), ("online_sample", *samples), ("target_sample", *samples),
                    ("loss", "f8"), ("largest_target", "f8"), ("batch_size", "i4"), ("optimizer_steps", "i8"),
                ]
            )  # fmt: skip
        number = len(self._updates)
        is_due = learning.batches.is_due(number) or learning.before is not None
        moments = None if optimizer is None else _optimizer_steps(optimizer)
        error = np.nan if loss is None else _or_infinite(_number_of(loss))
        # Every fourth tells enough of the targets.
        y = None if targets is None or not (is_due or number % 4 == 0) else np.asarray(_numbers(targets)).ravel()
        largest = np.nan if y is None or not y.size else _or_infinite(float(max(y.max(), -y.min())))
        arrays = self._batch(batch) if is_due and batch is not None else None
        actions = None if batch is None else batch.get("actions")
        size = 0 if actions is None else len(actions)
        (online_sums, online_sample), (target_sums, target_sample) = networks[0], networks[1] or (0, np.nan)
        row = (steps, online_sums, target_sums, online_sample, target_sample, error, largest, size, -1 if moments is None else moments)
        if not self._updates.append(row):
            self._say(f"updates after update {number}, which is as many as a file holds", "full")
        if arrays is not None and learning.batches.is_due(number):
            kept = {name: _array(array).reshape(len(arrays["actions"]), -1) for name, array in arrays.items()}
            if y is not None and len(y) == size:
                kept["targets"] = _array(y)[:, None]
            learning.batches.keep(number, kept)
            learning.batches.limit = min(MAX_BATCHES, max(10, MAX_ROWS // max(size, 1)))
        self._keep_whole_update(number, online, target, arrays, y, error, optimizer)
        self._write_now_and_then()

    def _keep_whole_update(
        self, number: int, online: Any, target: Any, batch: Any, targets: Any, loss: float, optimizer: Any
    ) -> None:
        """Writes down all numbers of an update if the networks before it were kept, and keeps them if the next update is due."""
        learning = self._learning
        before, learning.before = learning.before, None
        if before is not None and batch is not None:
            settings, _ = self._optimizer(optimizer)
            shapes = {name.partition(".")[2]: array.shape for name, array in before.items() if name.startswith("online.")}
            update = {**before, **{f"batch.{name}": _array(array) for name, array in batch.items()}}
            # Those of a rate that has just changed may not be the ones of this update.
            if learning.settings and learning.settings == settings:
                update["settings"] = settings
            q = _q_values(online, None, batch["observations"], list(shapes.values())[-1][0])
            if q is not None:
                update["result.q"] = q
            update.update(_network("result.online", online, shapes))
            moved = False
            if target is not None:
                after = _network("result.target", target, shapes)
                moved = any((before.get(name.replace("result.", "")) != array).any() for name, array in after.items())
                update.update(after)
            if targets is not None and targets.size == len(batch["actions"]):
                update["result.targets"] = _array(targets)
            if np.isfinite(loss):
                update["result.loss"] = np.array(loss)
            gradients = [parameter.grad for parameter in online.parameters()] if _is_torch(online) else [None]
            # `zero_grad` may have been called since.
            if all(gradient is not None for gradient in gradients) and any(bool((gradient != 0).any()) for gradient in gradients):
                update.update(_network("result.gradients", gradients, shapes))
            # A target network that moves may have moved before the update or after it: only the targets tell.
            if moved and targets is None:
                self._say("whole updates at which the target network moves: give `learned` the targets", "targets")
            else:
                learning.updates.keep(number, update)
        if learning.updates.is_due(number + 1):
            try:
                kept = _network("online", online)
                if sum(array.size for array in kept.values()) > MAX_WEIGHTS:
                    raise ValueError(f"it has more than {MAX_WEIGHTS} weights")
                shapes = {name.partition(".")[2]: array.shape for name, array in kept.items()}
                if target is not None:
                    kept.update(_network("target", target, shapes))
                learning.settings, optimizer = self._optimizer(optimizer)
                for name, values in _other_moments(optimizer, online).items():
                    kept.update(_network(name, values, shapes))
                if optimizer is not None and (moments := _adam(optimizer, online)) is not None:
                    kept["adam.steps"] = np.array([moments[0]], np.int64)
                    kept.update(_network("adam.m", moments[1], shapes))
                    kept.update(_network("adam.v", moments[2], shapes))
                learning.before = kept
            except ValueError as error:
                self._say(f"whole updates: {error}", "whole updates")

    def _optimizer(self, optimizer: Any) -> tuple[dict[str, Any], Any]:
        """What an optimizer says of itself, and the optimizer; nothing of one whose step `check` does not know."""
        try:
            return _optimizer_settings(optimizer), optimizer
        except ValueError as error:
            self._say(f"the step of the optimizer: {error}", "optimizer")
            return {}, None

    def _batch(self, batch: Mapping[str, Any]) -> Optional[dict[str, np.ndarray]]:
        """The arrays of a minibatch, not copied; None if they do not fit to each other."""
        arrays = {name: np.asarray(_numbers(batch[name])) for name in NEEDED + OPTIONAL if batch.get(name) is not None}
        missing = [name for name in NEEDED if name not in arrays]
        size = arrays["actions"].size if "actions" in arrays else 0
        wrong = [f"{name} {array.shape}" for name, array in arrays.items() if not array.ndim or len(array) != size or not size]
        wrong += [name for name, array in arrays.items() if not name.endswith("observations") and array.size != size]
        if missing or wrong or arrays["observations"].shape != arrays["next_observations"].shape:
            self._say(f"minibatches: they must have {', '.join(NEEDED)}, all as long; wrong are {', '.join(missing + wrong)}", "minibatches")
            return None
        shape = {name: (size, -1) if name.endswith("observations") else (size,) for name in arrays}
        return {name: array.reshape(shape[name]) for name, array in arrays.items()}

    def _write_now_and_then(self) -> None:
        """Writes the file whenever it has become twice as long: a killed loop leaves at least half of what it did."""
        if len(self._steps) + len(self._updates) >= self._next_write:
            self._next_write *= 2
            self._write(False)

    def _write(self, is_closed: bool) -> None:
        file = {f"steps.{name}": column for name, column in self._steps.columns()}
        file.update({f"updates.{name}": column for name, column in self._updates.columns()})
        batches = self._learning.batches.kept
        if batches:
            names = [name for name in next(iter(batches.values())) if all(name in batch for batch in batches.values())]
            sizes = [len(batch["actions"]) for batch in batches.values()]
            file["batches.update"] = np.repeat(np.array(list(batches), np.int64), sizes)
            for name in names:
                same_width = len({batch[name].shape[1] for batch in batches.values()}) == 1
                if same_width:
                    column = np.concatenate([batch[name] for batch in batches.values()])
                    file[f"batches.{name}"] = column if name.endswith("observations") else column[:, 0]
        for number, update in self._learning.updates.kept.items():
            file.update({f"update.{number}.{name}": array for name, array in update.items() if name != "settings"})
        env = self._environments[-1] if self._environments else None
        inner = next(iter(getattr(env, "envs", None) or ()), None)
        spec = getattr(env, "spec", None) or getattr(inner, "spec", None)
        facts = {
            "version": VERSION,
            "closed": is_closed,
            "environment": str(self._settings.get("environment") or getattr(spec, "id", "")),
            "environments": sum(recorded._count for recorded in self._environments),
            "max_episode_steps": getattr(spec, "max_episode_steps", None),
            "actions": self._num_actions() if env is not None else 0,
            "tensors": self._learning.names,
            "same_object": self._learning.same_object,
            "not_recorded": list(self._said.values()),
        }
        settings = {name: value for name, value in self._settings.items() if name != "environment"}
        metadata = {"trace": json.dumps(facts, default=_number), "settings": json.dumps(settings, default=_number)}
        updates = self._learning.updates.kept.items()
        metadata.update({f"update.{number}.settings": json.dumps(update["settings"]) for number, update in updates if "settings" in update})
        temporary = f"{self._path}.{os.getpid()}.tmp"
        try:
            # A file that is cut off later still has the steps.
            _tensors.write(temporary, file, metadata, "steps.")
            os.replace(temporary, self._path)
        except OSError:
            if os.path.exists(temporary):
                os.remove(temporary)
            raise


class _Table:
    """Rows of named columns, in one array that doubles when it is full."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.fields: dict[str, tuple[int, ...]] = {}
        self.rows = np.empty(0)
        self.length = 0

    def __len__(self) -> int:
        return self.length

    @property
    def is_full(self) -> bool:
        return self.length >= self.limit

    def begin(self, fields: list[Any]) -> None:
        self.rows = np.zeros(1024, np.dtype(fields))
        self.fields = {field[0]: field[2] if len(field) > 2 else () for field in fields}
        self.places = [self.rows[name] for name in self.fields]

    def append(self, row: tuple[Any, ...], count: Optional[int] = None) -> bool:
        """Adds a row, or several of which the values are arrays, in the order of the fields; False if there is no room."""
        start, end = self.length, self.length + (1 if count is None else count)
        if end > self.limit:
            self.limit = self.length
            return False
        while end > len(self.rows):
            self.rows = np.concatenate([self.rows, np.zeros_like(self.rows)])
            self.places = [self.rows[name] for name in self.fields]
        at: Any = start if count is None else slice(start, end)
        for place, value in zip(self.places, row):
            place[at] = value
        self.length = end
        return True

    def columns(self) -> list[tuple[str, np.ndarray]]:
        """The columns that hold something."""
        columns = [(name, self.rows[name][: self.length]) for name in self.fields]
        holds = lambda column: column.dtype.kind != "f" or not np.isnan(column).all()
        return [(name, column) for name, column in columns if column.size and holds(column)]


class _Kept:
    """At most so many things that are spread over all updates: whenever they are too many, every other one goes. The first stay."""

    def __init__(self, limit: int, first: int, period: int) -> None:
        self.limit, self.first, self.period = limit, first, period
        self.kept: dict[int, dict[str, Any]] = {}

    def is_due(self, number: int) -> bool:
        return number < self.first or number % self.period == 0

    def keep(self, number: int, thing: dict[str, Any]) -> None:
        while len(self.kept) >= self.limit and self.period < MAX_STEPS:
            self.period *= 2
            self.kept = {other: kept for other, kept in self.kept.items() if self.is_due(other)}
        if self.is_due(number):
            self.kept[number] = thing


class _Learning:
    """What is known of the networks."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.same_object, self.shared = False, 0
        self.torch: dict[str, tuple[list[Any], int, list[_Tensor]]] = {}
        self.modules: dict[str, Any] = {}
        self.before: Optional[dict[str, np.ndarray]] = None
        self.settings: dict[str, Any] = {}  # Of the optimizer, before the next update.
        self.batches = _Kept(MAX_BATCHES, 10, 8)
        # Update 0 has no network before it.
        self.updates = _Kept(MAX_UPDATES, 3, 32)

    def fingerprint(self, name: str, network: Any) -> tuple[list[int], np.ndarray]:
        """Checksums of two tensors, and some of their weights."""
        if _is_torch(network):
            tensors = self._torch_tensors(name, network)
        else:
            leaves = list(_leaves(network))
            self.names = self.names or [key or str(index) for index, (key, _) in enumerate(leaves)]
            tensors = [_Tensor(np.asarray(_numbers(leaf))) for _, leaf in leaves]
        if len(tensors) != len(self.names):
            raise ValueError(f"the {name} network has {len(tensors)} tensors after one of {len(self.names)}")
        # The weights of the first layer and of the last: of all it would take too long.
        matrices = [tensor for tensor in tensors if tensor.is_matrix] or tensors
        ends = (matrices[0], matrices[-1])
        return [tensor.checksum() for tensor in ends], np.concatenate([tensor.sample() for tensor in ends])

    def _torch_tensors(self, name: str, network: Any) -> list[_Tensor]:
        """Those of a module of PyTorch. Of tensors on the CPU the views are kept as long as the memory is the same."""
        parameters, calls, tensors = self.torch.get(name, ([], 0, []))
        # The module is asked again now and then: its parameters may have been exchanged.
        if calls % 64 == 0 or not parameters or self.modules.get(name) is not network:
            named = list(network.named_parameters())
            self.names = self.names or [key for key, _ in named]
            parameters, tensors, self.modules[name] = [value for _, value in named], [], network
        if [tensor.address for tensor in tensors] != [value.data_ptr() for value in parameters] or parameters[0].is_cuda:
            tensors = [_Tensor(value.detach().cpu().numpy(), value.data_ptr()) for value in parameters]
        self.torch[name] = (parameters, calls + 1, tensors)
        return tensors


class _Tensor:
    """An array of a network, as far as fingerprints need it."""

    def __init__(self, array: np.ndarray, address: int = 0) -> None:
        self.address, self.is_matrix = address, array.ndim > 1
        self.flat = array.reshape(-1)
        data = np.ascontiguousarray(self.flat).view(np.uint8)
        self.parts = [memoryview(data)]
        if data.size > 2 * CHECKSUM_BYTES:
            self.parts = [memoryview(data[:CHECKSUM_BYTES]), memoryview(data[-CHECKSUM_BYTES:])]
        count = min(SAMPLES // 2, data.size and len(self.flat))
        self.places = np.linspace(0, max(len(self.flat) - 1, 0), count).astype(int)

    def checksum(self) -> int:
        value = 0
        for part in self.parts:
            value = zlib.crc32(part, value)
        return value

    def sample(self) -> np.ndarray:
        return self.flat.take(self.places)


class _Environment:
    """An environment, or a vector of several, that behaves as the one within, and is of its class for `isinstance`."""

    _OWN = ("_env", "_recorder", "_offset", "_start", "_seed", "_count", "_is_vector", "_last", "_is_over", "_resets")

    def __init__(self, env: Any, recorder: Recorder, offset: int) -> None:
        self._env, self._recorder, self._offset, self._seed = env, recorder, offset, None
        space = getattr(env, "single_action_space", None) or getattr(env, "action_space", None)
        self._start = int(getattr(space, "start", 0)) if hasattr(space, "n") else 0
        count = getattr(env, "num_envs", None)
        self._is_vector = isinstance(count, int)
        self._count = count if isinstance(count, int) else 1
        self._last: Optional[np.ndarray] = None  # [environments, n]: what each has said last.
        self._is_over = np.zeros(self._count, bool)
        self._resets = np.zeros(self._count, np.uint8)

    @property
    def __class__(self) -> Any:
        return type(self._env)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__.get("_env"), name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _Environment._OWN:
            self.__dict__[name] = value
        else:
            setattr(self._env, name, value)

    def __enter__(self) -> Any:
        self._env.__enter__()
        return self

    def __exit__(self, *error: Any) -> Any:
        return self._env.__exit__(*error)

    def __repr__(self) -> str:
        return repr(self._env)

    def reset(self, *arguments: Any, **keywords: Any) -> Any:
        said = self._env.reset(*arguments, **keywords)
        self._recorder._try("reset", self._keep_reset, said, arguments, keywords)
        return said

    def step(self, action: Any) -> Any:
        if self._recorder._is_open:
            # The array may be written over before it is looked at.
            self._recorder._try("action", self._keep_action, action)
        said = self._env.step(action)
        self._recorder._try("step", self._keep_step, said)
        return said

    def _keep_action(self, action: Any) -> None:
        self.__dict__["_action"] = None
        if type(action) is int and not self._is_vector:
            self.__dict__["_action"] = action - self._start
            return
        actions = np.array(_numbers(action))
        if actions.dtype.kind not in "iub" or actions.size != self._count:
            raise ValueError(f"an action is {shown(action)}; it must be a whole number for each environment")
        actions = actions.astype(np.int64) - self._start
        self.__dict__["_action"] = actions.reshape(-1) if self._is_vector else int(actions.reshape(-1)[0])

    def _rows(self, observations: Any) -> np.ndarray:
        """A copy, [environments, n]."""
        return np.array(_numbers(observations), np.float32).reshape(self._count, -1)

    def _keep_reset(self, said: Any, arguments: Any, keywords: Any) -> None:
        is_pair = isinstance(said, tuple) and len(said) == 2 and isinstance(said[1], Mapping)
        rows = self._rows(said[0] if is_pair else said)
        mask = (keywords.get("options") or {}).get("reset_mask") if self._is_vector else None
        mask = np.ones(self._count, bool) if mask is None or self._last is None else np.array(mask, bool)
        self._last = rows if self._last is None else np.where(mask[:, None], rows, self._last)
        seed = keywords.get("seed", arguments[0] if arguments else None)
        is_again, self._seed = seed is not None and seed == self._seed, seed
        self._resets = np.where(mask, 2 if is_again else 1, self._resets).astype(np.uint8)
        self._is_over = self._is_over & ~mask

    def _keep_step(self, said: Any) -> None:
        action = self.__dict__.pop("_action", None)
        if len(said) == 5:
            observations, rewards, terminated, truncated, info = said
        else:  # Gym before 0.26
            observations, rewards, done, info = said
            terminated, truncated = (done, False) if not info.get("TimeLimit.truncated") else (False, True)
        rows = self._rows(observations)
        before, self._last = self._last, rows
        if before is None or action is None:
            return
        if not self._is_vector:
            # Who resets is the user, before the next step.
            flags = (bool(terminated), bool(truncated))
            columns = (action, _number_of(rewards), *flags, self._resets[0], self._offset)
            self._recorder._keep_steps(before[0], rows[0], None, *columns)
            self._resets[0] = 0
            return
        flags = [np.array(_numbers(flag), bool).reshape(-1) for flag in (terminated, truncated)]
        after, resets, ended = rows, np.zeros(self._count, np.uint8), flags[0] | flags[1]
        # Gymnasium's vectors reset by themselves: in the same step, which keeps the last observation in `info`, or in the next
        # one, which is then no step of the task. Where the user does it, `_is_over` is false by then.
        passed = np.ones(self._count, bool)
        mode = self._mode(info)
        if mode == "next_step":
            passed = ~self._is_over
            resets[~passed] = 1
        elif mode == "same_step" and ended.any():
            final = info.get("final_obs", info.get("final_observation"))
            after = rows.copy()
            for index in np.flatnonzero(ended):
                after[index] = np.asarray(_numbers(final[index]), np.float32).reshape(-1)
            resets[ended] = 1
        place = np.flatnonzero(passed)
        rewards = np.array(_numbers(rewards), np.float64).reshape(-1)
        columns = (action, rewards, *flags, self._resets, self._offset + np.arange(self._count))
        if len(place):
            self._recorder._keep_steps(before[place], after[place], place, *(column[place] for column in columns))
        self._is_over = ended & passed
        self._resets = resets

    def _mode(self, info: Mapping[str, Any]) -> str:
        if "final_obs" in info or "final_observation" in info:
            return "same_step"
        mode = getattr(self._env, "metadata", {}).get("autoreset_mode")
        name = str(getattr(mode, "value", mode) or "next_step").lower()
        return "disabled" if "disabled" in name else "same_step" if "same" in name else "next_step"


def _numbers(value: Any) -> Any:
    """What NumPy makes an array of: of a tensor of another library its numbers."""
    if type(value) is np.ndarray:
        return value
    if hasattr(value, "detach"):
        value = value.detach().cpu()
        value = value.float() if str(value.dtype) in ("torch.bfloat16", "torch.float16") else value
    return value.numpy() if hasattr(value, "numpy") else value


def _or_infinite(value: float) -> float:
    """NaN stands for what was not told."""
    return value if math.isfinite(value) else math.inf


def _number_of(value: Any) -> float:
    """A number, or the first of an array."""
    if isinstance(value, (float, int)):
        return float(value)
    if getattr(value, "size", 0) == 1 or hasattr(value, "requires_grad"):
        return float(value.item())
    return float(np.asarray(_numbers(value)).reshape(-1)[0])


def _optimizer_steps(optimizer: Any) -> Optional[int]:
    """How many steps an Adam has done; None if it does not say."""
    if hasattr(optimizer, "param_groups"):
        states = (state for state in optimizer.state.values() if "step" in state)
        state = next(states, None)
        return None if state is None else int(state["step"])
    moments = _adam(optimizer, None)
    return None if moments is None else moments[0]

"""The directory of a run."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Union

PathLike = Union[str, "os.PathLike[str]"]

KINDS = ("episode", "evaluation", "statistics", "end")
BEST, LAST = "checkpoints/best.safetensors", "checkpoints/last.safetensors"


def metrics(run: PathLike, kind: str = "episode") -> list[dict[str, Any]]:
    """The lines of a kind in a run's `metrics.jsonl`, in order. `pandas.DataFrame(metrics("runs/mine"))` is a table.

    Every line has `env_steps`, the environment steps of training so far. The kinds:

    - "episode": a training episode ended: `episode` (its number), `return`, `length` (steps), `mean_return_100`, `epsilon`,
      `loss` (None before learning), `updates`;
    - "evaluation": the greedy policy played: `episodes`, `mean`, `std`, `min`, `max` (returns), `mean_length`, `best`, `solved`;
    - "statistics": of the Q-values and the replay memory after an evaluation: `max_q`, `overestimation`, `action_gap`, …;
    - "end": the run has ended: `episodes`, `updates`, `reason`.

    docs/metrics.md of the project describes every field. A run that is still training has the lines written so far.

    Args:
        run: the directory of a run.
        kind: which lines.

    Raises ValueError for another kind or a line that is no JSON, FileNotFoundError if there is no `metrics.jsonl`.
    """
    if kind not in KINDS:
        raise ValueError(f"kind is {shown(kind)}; it must be one of {', '.join(map(repr, KINDS))}")
    path = Path(run) / "metrics.jsonl"
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing: give the directory of a run, which `cartpole-dqn train --out RUN` writes")
    lines = path.read_bytes().split(b"\n")
    # Behind the last line end stands nothing, or a line that is being written.
    events = [_event(path, number, line) for number, line in enumerate(lines[:-1], start=1)]
    return [event for event in events if event["event"] == kind]


def _event(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        event = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}, line {number}: not JSON ({error})") from None
    if not isinstance(event, dict) or not isinstance(event.get("event"), str):
        raise ValueError(f"{path}, line {number}: not an object with the field `event`")
    return event


def checkpoint_of(path: PathLike) -> Path:
    """The file of a policy: the file itself, or the best policy of a run, else its last, as for `cartpole-dqn eval`."""
    path = Path(path)
    if not path.is_dir():
        return path
    for name in (BEST, LAST):
        if (path / name).is_file():
            return path / name
    if (path / "study.json").is_file():
        raise FileNotFoundError(f"{path} is a study, whose trials keep scores and no policies: give a run or a .safetensors file")
    raise FileNotFoundError(f"{path} has no {BEST} and no {LAST}: give a run or a .safetensors file")


def shown(value: object) -> str:
    """A value for a message, at most about a line of it."""
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:97]}..."

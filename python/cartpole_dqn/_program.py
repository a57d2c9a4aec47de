"""Where the program is."""

from __future__ import annotations

import shutil
import sys
import sysconfig
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

NAME = "cartpole-dqn"


def program() -> str:
    """The path of the program `cartpole-dqn`: the one that was installed with this module, else the one in PATH.

    For example `subprocess.run([program(), "train", "--seed", "1", "--out", "runs/mine"], check=True)`.

    Raises FileNotFoundError if there is neither.
    """
    file = NAME + (".exe" if sys.platform == "win32" else "")
    for path in _installed(file):
        if path.is_file():
            return str(path.resolve())
    found = shutil.which(NAME)
    if found is None:
        raise FileNotFoundError(
            f"the program {NAME} is neither installed with this Python module nor in PATH: install a wheel for this "
            f"system with `pip install {NAME}`, or build the program with `cargo install --path . --locked` in a clone"
        )
    return found


def _installed(file: str) -> Iterator[Path]:
    """Where pip has put the program."""
    try:
        own = metadata.files(NAME) or []
    except metadata.PackageNotFoundError:
        return
    yield from (Path(str(path.locate())) for path in own if path.name == file)
    # `pip install --target DIR` moves the program to DIR/bin afterwards.
    yield Path(__file__).resolve().parents[1] / "bin" / file
    yield Path(sysconfig.get_path("scripts")) / file

"""`python -m cartpole_dqn …` is `cartpole-dqn …`, also where the directory of the program is not in PATH."""

from __future__ import annotations

import subprocess
import sys

from ._program import program


def main() -> int:
    try:
        path = program()
    except FileNotFoundError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    try:
        return subprocess.call([path, *sys.argv[1:]])
    except KeyboardInterrupt:  # The program got the same Ctrl-C and has ended.
        return 130


if __name__ == "__main__":
    sys.exit(main())

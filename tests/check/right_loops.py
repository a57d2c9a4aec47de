"""tests/check/right_loops.py --binary FILE --results FILE: some 300 right DQN loops, recorded with `cartpole_dqn.Recorder`. `cartpole-dqn check`
must name no mistake in any. A run that was stopped goes on where it was.

Needs torch, gymnasium[box2d], stable-baselines3, keras, jax and optax; loops of what is missing are left out."""

import argparse
import json
import pathlib
import sys
import time
import traceback
import warnings

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "interop"))
import recorder  # noqa: E402
from torch_loops import LOOPS  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True)
    parser.add_argument("--results", required=True, type=pathlib.Path, help="a line for each loop")
    parser.add_argument("--keep", required=True, type=pathlib.Path, help="a directory for the traces of false alarms")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--only", help="loops with this in their names")
    parser.add_argument("--backwards", action="store_true", help="begin with the last ones")
    arguments = parser.parse_args()
    np.seterr(all="ignore")
    warnings.simplefilter("ignore")
    arguments.keep.mkdir(exist_ok=True)
    arguments.results.touch()
    # Another process may write to the same results.
    done = lambda: [json.loads(line) for line in arguments.results.read_text().splitlines()]
    loops = {name: lambda path, seed, steps, one=one: one[0](path, seed, steps, **one[1]) for name, one in LOOPS.items()}
    loops |= {f"NumPy, {name}": lambda path, seed, steps, one=one: recorder.record(path, "", one, seed, steps) for name, one in recorder.RIGHT.items()}
    for seed in arguments.seeds:
        for name, record in list(loops.items())[:: -1 if arguments.backwards else 1]:
            if (name, seed) in {(one["loop"], one["seed"]) for one in done()} or (arguments.only and arguments.only not in name):
                continue
            path = str(arguments.keep / f"{name.replace(' ', '_').replace('/', '_')}.{seed}.trace")
            begin = time.process_time()
            try:
                record(path, seed, arguments.steps)
                names, verdict = recorder.judged(arguments.binary, path)
            except Exception as error:
                print(f"not run: {name}: {''.join(traceback.format_exception_only(error)).strip()}", flush=True)
                continue
            one = {"loop": name, "seed": seed, "steps": arguments.steps, "named": names, "facts": verdict["facts"], "unseen": verdict["unseen"]}
            one["seconds"] = round(time.process_time() - begin, 1)
            with arguments.results.open("a") as file:
                file.write(json.dumps(one, ensure_ascii=False) + "\n")
            if names:
                print(f"FALSE ALARM {path}: {names}", flush=True)
            else:
                pathlib.Path(path).unlink()
    results = done()
    alarms = [one for one in results if one["named"]]
    print(f"{len(alarms)} false alarms in {len(results)} right loops of {len({one['loop'] for one in results})} kinds")
    sys.exit(bool(alarms))


if __name__ == "__main__":
    main()

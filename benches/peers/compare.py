"""Our figures beside those of PyTorch, JAX, PureJaxRL, Keras and Gymnasium on this machine, one thread each, in turns.

`run.sh` installs them and calls this. `compare.py PART …` does only some of: update single training startup.
"""

import json
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

# One CPU for this process and all that it starts.
os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
os.environ["OMP_NUM_THREADS"] = "1"
HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
UNITS = {"ns": 1e-3, "µs": 1.0, "ms": 1e3, "s": 1e6}
SIZES = [([24, 24], 32), ([64, 64], 64), ([120, 84], 128), ([256, 256], 64)]


def build(name, *command):
    """Builds a target and returns its executable."""
    command = ["cargo", *command, name, "--message-format=json"]
    lines = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()
    artifacts = [m for m in map(json.loads, lines) if m.get("executable") and m["target"]["name"] == name]
    return artifacts[-1]["executable"]


def build_bench(name):
    return build(name, "bench", "--no-run", "--bench")


def build_binary():
    return build("cartpole-dqn", "build", "--release", "--bin")


def output(*command):
    return subprocess.run([str(c) for c in command], check=True, stdout=subprocess.PIPE, text=True).stdout


def our_update(program, name):
    """µs of one update, by benches/update.rs."""
    row = next(line for line in output(program, name).splitlines() if line.split()[0] == name)
    return float(row.split()[2])


def our_micro(program, name):
    """µs, divan's median of benches/micro.rs."""
    row = next(line for line in output(program, "--bench", name).splitlines() if f" {name} " in line)
    value, unit = re.findall(r"([\d.]+) (ns|µs|ms|s)\b", row)[2]
    return float(value) * UNITS[unit]


class Peer:
    """A module of this directory in a process of its own: the libraries' copies of LLVM do not bear each other."""

    def __init__(self, module):
        command = [sys.executable, HERE / "serve.py", module]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def measure(self, function, arguments, n):
        """A measurement of n repetitions in µs, after one that compiles and fills the caches."""

        def run():
            print(json.dumps([function, arguments, n]), file=self.process.stdin, flush=True)
            return float(self.process.stdout.readline())

        run()
        return run


def compare(what, ours, theirs, rounds=5):
    """Medians over rounds, ours and each of theirs in turns; every function returns µs."""
    measured = {name: [] for name in ("ours", *theirs)}
    for _ in range(rounds):
        for name, measure in {"ours": ours, **theirs}.items():
            measured[name].append(measure())
    medians = {name: statistics.median(values) for name, values in measured.items()}
    for name, values in measured.items():
        ratio = medians[name] / medians["ours"]
        raw = " ".join(f"{value:.4g}" for value in values)
        print(f"{what:<24} {name:<10} {medians[name]:>12.4g} us {ratio:>10.4g} x   [{raw}]", flush=True)


def update():
    program = build_bench("update")
    torch, jax, keras = map(Peer, ("torch_dqn", "jax_dqn", "keras_dqn"))
    for hidden, batch in SIZES:
        name = "-".join(map(str, [4, *hidden, 2]))
        theirs = {
            "PyTorch": torch.measure("updates", (hidden, batch), 300),
            "JAX": jax.measure("updates", (hidden, batch), 2000 if batch < 64 else 300),
            "Keras": keras.measure("updates", (hidden, batch), 100),
        }
        compare(f"update {name} b{batch}", lambda: our_update(program, name), theirs)


def single():
    program = build_bench("micro")
    torch, gymnasium = Peer("torch_dqn"), Peer("gymnasium_steps")
    forward = {"PyTorch": torch.measure("forwards", (), 5000)}
    compare("forward of 1", lambda: our_micro(program, "forward"), forward)
    step = {"Gymnasium": gymnasium.measure("steps", (), 20000)}
    compare("environment step", lambda: our_micro(program, "environment_step"), step)


def child(*command):
    """Standard output, seconds and peak memory in MB of a process."""
    start = time.perf_counter()
    process = subprocess.Popen([str(c) for c in command], stdout=subprocess.PIPE, text=True, cwd=HERE)
    out = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, command
    return out, time.perf_counter() - start, usage.ru_maxrss / 1024


def our_training(binary, config, *sets, directory=None):
    """Summary, seconds of the whole process and peak memory in MB of a run."""
    with tempfile.TemporaryDirectory(dir=directory) as directory:
        arguments = [argument for key in sets for argument in ("--set", key)]
        run = ("train", "--config", config, "--out", f"{directory}/run", "--quiet", "--json")
        out, seconds, memory = child(binary, *run, *arguments)
        return json.loads(out), seconds, memory


def training():
    """Whole runs in turns. PyTorch's is cut short, and its steps/s taken to the whole run; PureJaxRL's compiles before
    the clock starts. Ours is whole."""
    binary = build_binary()
    short, warmup, whole = 50_000, 10_000, 500_000
    memory = {}

    def ours():
        summary, _, memory["ours"] = our_training(binary, HERE / "cleanrl.json")
        return summary["wall_seconds"] * 1e6

    def pytorch():
        out, _, memory["PyTorch"] = child(sys.executable, HERE / "torch_dqn.py", short)
        parts = json.loads(out)
        print(f"PyTorch, {short} steps: {parts}")
        return (parts["before_learning"] + parts["learning"] * (whole - warmup) / (short - warmup)) * 1e6

    def purejaxrl():
        out, _, memory["PureJaxRL"] = child(sys.executable, HERE / "purejaxrl_dqn.py")
        print(f"PureJaxRL: {out}", end="")
        return json.loads(out)["training"] * 1e6

    compare("CleanRL's settings", ours, {"PyTorch": pytorch, "PureJaxRL": purejaxrl}, rounds=3)
    for name, megabytes in memory.items():
        print(f"{name}: peak memory {megabytes:.1f} MB, {megabytes / memory['ours']:.1f} x", flush=True)

    tutorial = ROOT / "configs/tutorial.json"
    sets = ("replay.update=minibatch", "budget.steps=200000", "evaluation.every_steps=1000000")
    for loop, sets in [("compiled_loop", sets), ("tutorial_loop", ())]:
        summary, *_ = our_training(binary, tutorial, *sets)
        ours = summary["env_steps"] / summary["wall_seconds"]
        theirs = float(child(sys.executable, "-c", f"import keras_dqn; print(keras_dqn.{loop}())")[0])
        print(f"Keras, {loop}: ours {ours:.0f} steps/s, theirs {theirs:.4g} steps/s: {ours / theirs:.0f} x", flush=True)


def startup():
    """A whole run of one step, which writes and syncs five files, in memory and on disk, against an import."""
    binary = build_binary()
    sets = ("replay.warmup_steps=0", "replay.batch_size=1", "learn.every_steps=1", "budget.steps=1")
    run = lambda directory: our_training(binary, HERE / "cleanrl.json", *sets, directory=directory)[1] * 1e6
    importing = lambda: child(sys.executable, "-c", "import torch")[1] * 1e6
    compare("a run of one step", lambda: run("/dev/shm"), {"on disk": lambda: run(None), "PyTorch": importing})


def versions():
    """What is measured, on what."""
    names = [line.split("==")[0] for line in (HERE / "requirements.txt").read_text().split()]
    cpu = next(line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name"))
    commit = output("git", "-C", ROOT, "describe", "--always", "--dirty").strip()
    print(f"commit {commit}, {output('rustc', '--version').strip()}, {cpu.split(': ')[1]}")
    libraries = ", ".join(f"{name} {version(name)}" for name in names)
    print(f"Python {platform.python_version()}, {libraries}", flush=True)


if __name__ == "__main__":
    versions()
    parts = {"update": update, "single": single, "training": training, "startup": startup}
    for part in sys.argv[1:] or parts:
        parts[part]()

#!/usr/bin/env python3
"""Tests the module of python/ beside the program.

    python python_module.py --binary target/release/cartpole-dqn               # the module of this clone
    python python_module.py --binary BINARY --installed                        # the module that pip has installed
"""

import argparse
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import gymnasium
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
EPISODES = 20
# Gymnasium's sine and cosine differ from ours in the last bit now and then, see gymnasium_eval.py.
MAX_PARTED = 1


def require(condition, message):
    if not condition:
        sys.exit(f"FAILED: {message}")


def refuses(error, words, function, *arguments, **keywords):
    """The message of the error, which must hold the words."""
    try:
        function(*arguments, **keywords)
    except error as raised:
        message = str(raised)
        require(all(word in message for word in words), f"{words} are not all in: {message}")
        require(len(message) < 1000, f"a message of {len(message)} characters")
        return message
    sys.exit(f"FAILED: {function.__name__} accepts what it must refuse: {words}")


def run(*command, **keywords):
    return subprocess.run([str(word) for word in command], check=True, capture_output=True, text=True, **keywords).stdout


def policies_play_as_eval_does(binary, runs):
    """Policy's actions in Gymnasium bring the returns that `eval` reports."""
    from cartpole_dqn import Policy

    for name in runs:
        policy = Policy(name)
        score = json.loads(run(binary, "eval", name, "--episodes", EPISODES, "--json"))
        require(str(policy.file) == score["policy"]["file"], f"{name}: {policy.file}, eval plays {score['policy']['file']}")
        require(policy.env_steps == score["policy"]["env_steps"], f"{name}: step {policy.env_steps}")
        env, returns = gymnasium.make(policy.environment), []
        for seed in range(score["seed"], score["seed"] + EPISODES):
            observation, _ = env.reset(seed=seed)
            total, ended = 0.0, False
            while not ended:
                action, state = policy.predict(observation)
                require(state is None, "predict returns a state")
                observation, reward, terminated, truncated, _ = env.step(action)
                total, ended = total + reward, terminated or truncated
            returns.append(total)
        equal = sum(ours == theirs for ours, theirs in zip(returns, score["returns"]))
        require(equal >= EPISODES - MAX_PARTED, f"{name}: returns {returns}, eval's {score['returns']}")
        print(f"{name}: {policy}: {equal} of {EPISODES} returns are eval's, mean {np.mean(returns):.2f}")


def the_quick_actions_are_those_of_the_exact_values(runs):
    """`predict` of a batch, of its rows, and the program's own Q-values agree."""
    from cartpole_dqn import Policy

    rng = np.random.default_rng(0)
    for name in runs:
        policy = Policy(name)
        batch = rng.normal(size=(2000, policy.observation_size)).astype(np.float32)
        batch[1000:] *= rng.choice([1e-30, 1e-3, 1e3, 1e30], size=(1000, 1)).astype(np.float32)
        actions, _ = policy.predict(batch, None, np.zeros(2000, bool), deterministic=True)
        require(actions.shape == (2000,) and actions.dtype == np.int64, f"{actions.shape} {actions.dtype}")
        with np.errstate(over="ignore", invalid="ignore"):
            exact = policy._q.values(batch)
        finite = np.isfinite(exact).all(axis=1)
        require(finite.sum() > 1500 and (actions == exact.argmax(axis=1))[finite].all(), f"{name}: other actions")
        rows = [policy.predict(row)[0] for row in batch[:50]]
        require(rows == list(actions[:50]), f"{name}: a row alone has another action")
        require(policy.q_values(batch[0]).shape == (policy.num_actions,), f"{name}: {policy.q_values(batch[0]).shape}")
    for wrong in ([0.0] * 3, [[0.0] * 5], [[[0.0] * 4]], "abcd", [0.0, 0.0, None, 0.0], [], {}):
        refuses(ValueError, ["(4,)", "(B, 4)"], Policy(runs[0]).predict, wrong)
    refuses(ValueError, ["NaN"], Policy(runs[0]).predict, [0.0, np.nan, 0.0, 0.0])


def q_values_are_those_of_the_trace(binary, name):
    """The Q-values have the bits that `eval --trace` writes."""
    from cartpole_dqn import Policy

    trace = run(binary, "eval", name, "--episodes", 2, "--trace", "-").splitlines()
    steps = [json.loads(line) for line in trace]
    values = Policy(name).q_values(np.array([step["state"] for step in steps]))
    require((values == np.float32([step["q_values"] for step in steps])).all(), f"{name}: other Q-values")
    print(f"{name}: {len(steps)} Q-values are those of the trace, bit for bit")


def equals_are_decided_by_the_first(_):
    """Of equal Q-values the first action is taken, and foreign networks are found under their names."""
    from cartpole_dqn import Policy
    from safetensors.numpy import save_file

    layer = {"weight": np.float64([[0.0, 1.0], [0.0, 1.0], [0.0, 0.5]]), "bias": np.zeros(3)}
    for stem in ("0", "q_net.q_net.0", "network.4", "layer1"):
        save_file({f"{stem}.{kind}": value for kind, value in layer.items()}, "foreign.safetensors")
        policy = Policy("foreign.safetensors")
        require(policy.environment is None and (policy.observation_size, policy.num_actions) == (2, 3), str(policy))
        require(policy.predict([5.0, 1.0])[0] == 0, "not the first of equals")
        require(list(policy.predict([[0, 1], [0, -1], [0, 0]])[0]) == [0, 2, 0], "not the first of equals")


def broken_policies_are_refused(_):
    """A file that holds no policy gives one sentence that says why."""
    from cartpole_dqn import Policy
    from safetensors.numpy import save_file

    w, b = np.zeros((2, 4), np.float32), np.zeros(2, np.float32)
    for arrays, words in [
        ({"a": b}, ["no policy"]),
        ({"0.weight": w}, ["0.bias"]),
        ({"0.weight": w, "0.bias": np.zeros(3, np.float32)}, ["0.bias", "(3,)"]),
        ({"0.weight": b, "0.bias": b}, ["0.weight"]),
        ({"0.weight": w, "0.bias": b, "2.weight": w, "2.bias": b}, ["2.weight", "(2, 4)"]),
        ({"0.weight": w, "0.bias": b, "3.weight": w, "3.bias": b}, ["no policy"]),
        ({"0.weight": w + np.float32(np.nan), "0.bias": b}, ["0.weight", "NaN"]),
        ({"0.weight": w.astype(np.float16), "0.bias": b}, ["0.weight", "float16"]),
        ({"q_table": np.zeros((3, 2), np.float32)}, ["table.edges.0"]),
        ({"q_table": np.zeros((3, 2), np.float32), "table.edges.0": np.float32([2, 1])}, ["table.edges.0", "ascend"]),
    ]:
        save_file(arrays, "broken.safetensors")
        refuses(ValueError, ["broken.safetensors", *words], Policy, "broken.safetensors")
    refuses(FileNotFoundError, ["nowhere"], Policy, "nowhere")
    Path("empty").mkdir()
    refuses(FileNotFoundError, ["empty", "best.safetensors", "give a run"], Policy, "empty")


def tensors_are_those_of_the_reference(runs):
    """`tensors` reads what the package safetensors reads."""
    from cartpole_dqn import tensors
    from safetensors.numpy import load_file, save_file

    files = [f"{name}/checkpoints/{file}.safetensors" for name in runs for file in ("best", "last")]
    kinds = [np.float64, np.float32, np.float16, np.int64, np.int32, np.int16, np.int8, np.uint64, np.uint32, np.uint16, np.uint8, bool]
    save_file({str(np.dtype(kind)): np.arange(6).reshape(2, 3).astype(kind) for kind in kinds} | {"none": np.zeros((0, 4))}, "kinds.safetensors")
    for file in [*files, "kinds.safetensors"]:
        ours, theirs = tensors(file), load_file(file)
        require(ours.keys() == theirs.keys(), f"{file}: {ours.keys()}")
        for name, array in ours.items():
            same = array.dtype == theirs[name].dtype and array.shape == theirs[name].shape and array.tobytes() == theirs[name].tobytes()
            require(same and array.flags.writeable, f"{file}: {name}")
    require(tensors(runs[0]).keys() == load_file(files[0]).keys(), "a run's tensors are not those of its best policy")


def header(entries, data=b"", metadata=None):
    text = json.dumps(({"__metadata__": metadata} if metadata is not None else {}) | entries).encode()
    return struct.pack("<Q", len(text)) + text + data


def malformed_files_are_refused(runs):
    """Cut off, changed and nonsensical files each give a ValueError with the file's name."""
    from cartpole_dqn import tensors

    whole = Path(runs[0], "checkpoints/best.safetensors").read_bytes()
    length = 8 + int.from_bytes(whole[:8], "little")
    cases = [whole[:size] for size in (0, 1, 7, 8, 9, length - 1, length, length + 1, len(whole) - 1)] + [whole + b"\0"]
    for place in [*range(0, len(whole), 97), *range(0, 200)]:
        changed = bytearray(whole)
        changed[place] ^= 1 << place % 8
        cases.append(bytes(changed))
    entry = lambda **more: {"t": {"dtype": "F32", "shape": [1], "data_offsets": [0, 4]} | more}
    four = b"\0" * 4
    cases += [header(entry(**wrong), four) for wrong in (
        {"dtype": "F8_E4M3"}, {"dtype": 7}, {"dtype": None}, {"shape": [2]}, {"shape": [-1]}, {"shape": [True]}, {"shape": 1}, {"shape": [1.0]},
        {"shape": [10**40, 10**40]}, {"shape": [0, 10**40], "data_offsets": [0, 0]}, {"shape": [0, 2**40, 2**40], "data_offsets": [0, 0]},
        {"shape": [1] * 40}, {"data_offsets": [4, 8]}, {"data_offsets": [4, 0]}, {"data_offsets": [0]},
        {"data_offsets": [-4, 0]}, {"data_offsets": ["0", "4"]}, {"data_offsets": [0, 10**4000]},
    )]
    cases += [header({"t": value}, four) for value in (1, None, [], "x" * 10**6)] + [header({"x" * 10**6: 1})]
    cases += [struct.pack("<Q", len(text)) + text for text in (b"[]", b"1", b"{", b"\xff\xfe", b"[" * 10**5, b'{"a":' * 10**5, b'{"t":1,"t":1}', b"NaN")]
    cases += [header(entry(), four, metadata) for metadata in (0, 7, "", ["x"], {"a": 1}, {"cartpole-dqn": "{"}, {"cartpole-dqn": "[]"},
                                                               {"cartpole-dqn": '{"sha256":7}'}, {"cartpole-dqn": '{"sha256":"00"}'})]
    cases += [struct.pack("<Q", 2**64 - 1), b"PK\x03\x04" + bytes(20), b"\x80\x04" + bytes(20), b"\x89HDF" + bytes(20), b"\x93NUMPY" + bytes(20)]
    two = {name: {"dtype": "F32", "shape": [1], "data_offsets": [0, 4]} for name in "ab"}
    cases += [header(two, four), header({f"t{i}": {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]} for i in range(4097)})]
    for number, case in enumerate(cases):
        Path("malformed.safetensors").write_bytes(case)
        try:
            tensors("malformed.safetensors")
        except ValueError as error:
            message = str(error)
            require("malformed.safetensors" in message and len(message) < 1000, message[:2000])
        else:
            require(False, f"malformed file {number} is accepted: {case[:300]}")
    print(f"{len(cases)} malformed files are refused")


def metrics_are_the_lines(runs):
    """Every kind of line, and a run that is still being written."""
    from cartpole_dqn import metrics

    for name in runs:
        lines = [json.loads(line) for line in Path(name, "metrics.jsonl").read_text().splitlines()]
        kinds = {line["event"] for line in lines}
        require(kinds == {"episode", "evaluation", "statistics", "end"}, f"{name}: {kinds}")
        for kind in kinds:
            require(metrics(name, kind) == [line for line in lines if line["event"] == kind], f"{name}: {kind}")
        require(metrics(name) == metrics(name, "episode"), "the default is another kind")
        summary = json.loads(Path(name, "summary.json").read_text())
        require(metrics(Path(name), "end")[0]["updates"] == summary["updates"], f"{name}: updates")
        require(metrics(name, "evaluation")[-1]["mean"] == summary["final_evaluation"]["mean"], f"{name}: the last evaluation")
    refuses(ValueError, ["'episodes'", "'episode'", "'evaluation'", "'statistics'", "'end'"], metrics, runs[0], "episodes")
    refuses(FileNotFoundError, ["metrics.jsonl", "nowhere"], metrics, "nowhere")
    cut = Path("cut")
    cut.mkdir()
    (cut / "metrics.jsonl").write_bytes(Path(runs[0], "metrics.jsonl").read_bytes()[:1000])
    require(0 < len(metrics(cut)) < 20, "a line that is being written")
    for line in (b"{", b"[]", b"\xff", b'{"event":1}', b"[" * 10**5):
        (cut / "metrics.jsonl").write_bytes(b'{"event":"episode"}\n' + line + b"\n")
        refuses(ValueError, ["line 2"], metrics, cut)


def the_program_is_found(binary, module):
    """In PATH, and by `python -m`; where there is none, one sentence says what to do."""
    found = [sys.executable, "-c", "from cartpole_dqn import program; print(program())"]
    bare = {"PYTHONPATH": str(module)} if module else {}
    with_program = {**bare, "PATH": str(Path(binary).resolve().parent)}
    path = run(*found, env=with_program).strip()
    require(module is None or path == str(Path(binary).resolve()), f"program() is {path}")
    require(run(path, "--version").startswith("cartpole-dqn "), path)
    version = subprocess.run([sys.executable, "-m", "cartpole_dqn", "--version"], env=with_program, capture_output=True, text=True)
    require(version.stdout == run(path, "--version"), version.stdout + version.stderr)
    wrong = subprocess.run([sys.executable, "-m", "cartpole_dqn", "no-such-command"], env=with_program, capture_output=True)
    require(wrong.returncode == 2, f"exit code {wrong.returncode}")
    if module:
        nothing = subprocess.run([sys.executable, "-m", "cartpole_dqn"], env={**bare, "PATH": ""}, capture_output=True, text=True)
        require(nothing.returncode == 1 and nothing.stdout == "" and "Traceback" not in nothing.stderr, nothing.stderr)
        require(all(word in nothing.stderr for word in ("neither", "PATH", "pip install", "cargo install")), nothing.stderr)
    print(f"program() is {path}")


def only_numpy_is_imported(module):
    code = "import sys, cartpole_dqn; print(sorted({name.partition('.')[0] for name in sys.modules} & {'torch', 'keras', 'jax', 'tensorflow', 'safetensors', 'gymnasium', 'pandas'}))"
    environment = os.environ | ({"PYTHONPATH": str(module)} if module else {})
    require(run(sys.executable, "-c", code, env=environment).strip() == "[]", "another library is imported")


def wrong_updates_are_refused(_):
    """What is not of the form that the documentation says is refused before the update is done, and nothing is written."""
    from cartpole_dqn import save_update

    online = [np.zeros((4, 3)), np.zeros(3), np.zeros((3, 2)), np.zeros(2)]
    batch = {"observations": np.zeros((5, 4)), "next_observations": np.zeros((5, 4)), "actions": np.zeros(5, int),
             "rewards": np.zeros(5), "terminated": np.zeros(5, bool)}
    right = {"online": online, "target": online, "optimizer": None, "batch": batch, "update": {"loss": 1.0}}
    # Behind a function of the update, everything that is wrong before it is found before it is called.
    done = []
    update = lambda: done.append(1)
    swapped = [array.T for array in online]
    without = {name: value for name, value in batch.items() if name != "rewards"}
    for wrong, words in [
        ({"online": online[:-1]}, ["online", "weight and a bias"]),
        ({"online": online[:2] + online[:2]}, ["fit to each other", "[in, out]"]),
        ({"online": swapped}, ["fit to each other"]),
        ({"online": None}, ["online", "NoneType"]),
        ({"online": "abc"}, ["no array"]),
        ({"online": [object()]}, ["no array"]),
        ({"target": online[:2]}, ["target", "layers"]),
        ({"optimizer": (3, online[:2], online)}, ["adam.m"]),
        ({"optimizer": 7}, ["optimizer", "int"]),
        ({"batch": without}, ["'rewards'"]),
        ({"batch": batch | {"reward": 1}}, ["'reward'", "rewards"]),
        ({"batch": batch | {"rewards": np.zeros(4)}}, ["'rewards'", "(4,)", "(5,)"]),
        ({"batch": batch | {"observations": np.zeros((5, 3))}}, ["'observations'", "(5, 3)"]),
        ({"batch": batch | {"actions": ["left"] * 5}}, ["no array"]),
        ({"gama": 0.9}, ["'gama'", "gamma"]),
        ({"gamma": object()}, ["setting"]),
    ]:
        refuses(ValueError, words, save_update, "refused.safetensors", **{**right, "update": update, **wrong})
    for result, words in [
        (None, ["targets, loss"]), ((1,), ["targets, loss"]), ({}, ["nothing"]), ({"target_q": 1}, ["'target_q'", "targets"]),
        ((None, None, online[:2]), ["gradients", "layers"]),
    ]:
        refuses(ValueError, words, save_update, "refused.safetensors", **{**right, "update": lambda: result})
    require(not done and not Path("refused.safetensors").exists(), "an update was done, or a file written")


def updates_of_all_forms_are_the_same(binary):
    """A NumPy update as lists, as a tree with more than ten layers, and as PyTorch's names gives the same file."""
    from cartpole_dqn import save_update, tensors

    rng = np.random.default_rng(1)
    online = [rng.normal(size=size) for _ in range(12) for size in ((4, 4), (4,))]
    batch = {"observations": rng.normal(size=(5, 4)), "next_observations": rng.normal(size=(5, 4)), "actions": np.arange(5)[:, None] % 4,
             "rewards": np.ones(5), "terminated": [False, True, False, False, True]}
    tree = {f"Dense_{i}": {"kernel": online[2 * i], "bias": online[2 * i + 1]} for i in reversed(range(12))}
    state = {f"net.{2 * i}.{kind}": value for i in range(12) for kind, value in (("weight", online[2 * i].T), ("bias", online[2 * i + 1]))}
    files = []
    for form in (online, {"params": tree}, state, [tuple(online[i : i + 2]) for i in range(0, 24, 2)]):
        save_update("form.safetensors", form, form, (2, form, form), batch, {"loss": np.float32(1)}, gamma=np.float64(0.5))
        files.append(Path("form.safetensors").read_bytes())
    require(all(file == files[0] for file in files), "the forms differ")
    require((tensors("form.safetensors")["online.20.weight"] == online[20].T).all(), "a weight is not [out, in]")
    # What is read from a model: its weights after a function has done the update; nothing where the results are given.
    class Model:
        weights = trainable_variables = [type("Variable", (), {"name": "v", "numpy": lambda self, value=value: value})() for value in online]

        def __call__(self, observations, training):
            require(not training and observations.shape == (5, 4), "the model is asked as if it learned")
            return observations * (2 if done else 1)

    class Raises(Model):
        def __call__(self, *_, **__):
            raise TypeError("another form of observations")

    class OnTorch(Model):
        """A model of Keras on PyTorch is a module too."""

        named_parameters = state_dict = parameters = lambda self: []

    for model, update, was_done in (
        (OnTorch(), lambda: done.append(1) or (np.ones(5), None), True), (Model(), lambda: done.append(1) or (np.ones(5), None), True), (Raises(), lambda: (np.ones(5), None), True),
        (Model(), {"targets": np.ones(5)}, False),
    ):  # fmt: skip
        done: list[int] = []
        save_update("model.safetensors", model, Model(), None, batch, update)
        file = tensors("model.safetensors")
        require(("result.online.0.bias" in file) == ("result.target.0.bias" in file) == was_done, "the weights after the update")
        has_q = was_done and not isinstance(model, Raises)
        require(("result.q" in file) == has_q, "the Q-values")
        require(not has_q or (file["result.q"] == batch["observations"]).all(), "the model was asked after the update")
    # Other networks are asked by a function of theirs, or the update says what they said.
    forward = lambda network, observations: observations @ network[0]
    for update, asked in (({"loss": 1.0}, {"forward": forward}), (lambda: {"loss": 1.0, "q": forward(online, batch["observations"])}, {})):
        save_update("asked.safetensors", online, None, None, batch, update, **asked)
        require((tensors("asked.safetensors")["result.q"] == forward(online, batch["observations"])).all(), "the Q-values")
    refuses(ValueError, ["forward", "(5,)", "(5, 4)"], save_update, "x", online, None, None, batch, {"loss": 1.0}, forward=lambda w, s: s[:, 0])
    # An optimizer of PyTorch says its settings itself, and what is given with them goes before it.
    class SGD:
        param_groups = [{"params": [], "lr": 0.01, "momentum": 0.9, "dampening": 0, "weight_decay": 0, "nesterov": False}]
        state: dict = {}

    save_update("settings.safetensors", form, None, SGD(), batch, {"loss": 1.0}, learning_rate=0.5, environment="CartPole-v1")
    with open("settings.safetensors", "rb") as file:
        header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
    said = json.loads(header["__metadata__"]["settings"])
    require(said == {"optimizer": "sgd", "learning_rate": 0.5, "weight_decay": 0.0, "momentum": 0.9, "environment": "CartPole-v1"}, said)
    # m is not Adam's, v is negative: `check` reads the file so far that it says so.
    code = subprocess.run([binary, "check", "form.safetensors"], capture_output=True, text=True)
    require(code.returncode == 2 and "adam.v" in code.stderr, code.stderr)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True, help="the cartpole-dqn to compare with")
    parser.add_argument("--installed", action="store_true", help="test the installed module, and update functions with it")
    arguments = parser.parse_args()
    binary = shutil.which(arguments.binary) or arguments.binary
    binary = str(Path(binary).resolve())
    module = None if arguments.installed else ROOT / "python"
    if module:
        sys.path.insert(0, str(module))
    with tempfile.TemporaryDirectory() as directory:
        os.chdir(directory)
        run(binary, "train", "--config", ROOT / "configs/smoke.json", "--quiet", "--out", "smoke")
        run(binary, "train", "--config", ROOT / "configs/cartpole.json", "--seed", 2, "--quiet", "--out", "solved")
        run(binary, "train", "--config", ROOT / "configs/q_table.json", "--quiet", "--out", "table")
        run(binary, "train", "--config", ROOT / "configs/mountain_car.json", "--set", "budget.steps=5000", "--quiet", "--out", "car")
        last = "solved/checkpoints/last.safetensors"
        policies_play_as_eval_does(binary, ["smoke", "solved", last, "table", "car"])
        the_quick_actions_are_those_of_the_exact_values(["smoke", "solved", "table"])
        q_values_are_those_of_the_trace(binary, "solved")
        equals_are_decided_by_the_first(None)
        broken_policies_are_refused(None)
        tensors_are_those_of_the_reference(["smoke", "table"])
        malformed_files_are_refused(["smoke"])
        metrics_are_the_lines(["smoke", "table"])
        the_program_is_found(binary, module)
        only_numpy_is_imported(module)
        wrong_updates_are_refused(None)
        updates_of_all_forms_are_the_same(binary)
        os.chdir(ROOT)
    print("the Python module is right")


if __name__ == "__main__":
    main()

"""tests/check/recorder_cost.py [--binary FILE]: what `cartpole_dqn.Recorder` costs in a loop of PyTorch, by blocks of steps with and without it in
turn, and the size of a trace of 100,000 steps, with the seconds that `cartpole-dqn check` needs for it.

Needs torch, numpy and gymnasium."""

import argparse
import os
import subprocess
import tempfile
import time

import gymnasium
import numpy as np
import torch
from torch_loops import CLEANRL, TUTORIAL, Learner, Memory, Recorder

BLOCK = 100


def ratios(path, option, steps):
    """CPU seconds of blocks with the recorder over those of the blocks without."""
    torch.manual_seed(0)
    rng, recorder = np.random.default_rng(0), Recorder(path, gamma=0.99)
    plain = gymnasium.make("CartPole-v1")
    envs = [plain, recorder.environment(plain)]
    learner, memory = Learner(4, 2, option), Memory(10_000, 4, rng, False)
    observation, spent = envs[1].reset(seed=0)[0], [[], []]
    for block in range(steps // BLOCK):
        records = block % 2
        begin = time.process_time()
        for _ in range(BLOCK):
            with torch.no_grad():
                q = learner.online(torch.as_tensor(observation[None]))[0]
            action = int(rng.integers(2)) if rng.random() < 0.1 else int(q.argmax())
            if records:
                recorder.acting(q, 0.1)
            following, reward, terminated, truncated, _ = envs[records].step(action)
            memory.append(observations=observation, next_observations=following, actions=action, rewards=reward, terminated=terminated, truncated=truncated, discounts=0.99)
            observation = envs[records].reset()[0] if terminated or truncated else following
            if memory.length < option["size"]:
                continue
            batch = memory.sample(option["size"])
            y, loss, _ = learner.update(batch)
            if records:
                recorder.learned(online=learner.online, target=learner.target, batch=batch, targets=y, loss=loss, optimizer=learner.optimizer)
        spent[records].append(time.process_time() - begin)
    recorder.close()
    # Each block beside its neighbour; the first ones have more of what is kept whole.
    pairs = [with_it / without for without, with_it in zip(*spent)]
    return pairs[:5], pairs[5:]


def large(path, steps=100_000):
    """A trace of so many steps, with an update at each."""
    recorder, rng = Recorder(path, gamma=0.99), np.random.default_rng(0)
    env = recorder.environment(gymnasium.make("CartPole-v1"))
    learner, memory = Learner(4, 2, {"hidden": (120, 84)}), Memory(10_000, 4, rng, False)
    observation, _ = env.reset(seed=0)
    parameters = [p.detach().numpy() for p in learner.online.parameters()]
    for step in range(steps):
        action = int(rng.integers(2))
        recorder.acting(np.zeros(2, np.float32), 1.0)
        following, reward, terminated, truncated, _ = env.step(action)
        memory.append(observations=observation, next_observations=following, actions=action, rewards=reward, terminated=terminated, truncated=truncated, discounts=0.99)
        observation = env.reset()[0] if terminated or truncated else following
        if step >= 1000:
            batch = memory.sample(64) if step % 8 == 0 or step < 1100 else batch
            parameters[0][0, 0] += 1e-3
            parameters[4][0, 0] += 1e-3
            if step % 500 == 0:
                learner.target.load_state_dict(learner.online.state_dict())
            recorder.learned(online=learner.online, target=learner.target, batch=batch, targets=batch["rewards"], loss=1.0)
    recorder.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary")
    parser.add_argument("--steps", type=int, default=4000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        path = f"{directory}/one.trace"
        for name, option in (("PyTorch's tutorial, 128-128, batch 128", TUTORIAL), ("CleanRL's network 120-84, batch 128, an update per step", CLEANRL), ("64-64, batch 32", {"size": 32})):
            first, later = ratios(path, option, arguments.steps)
            print(f"{name}: {np.median(later):.3f} times the CPU seconds (quartiles {np.quantile(later, 0.25):.3f} to {np.quantile(later, 0.75):.3f}); first 1,000 steps {np.median(first):.3f}", flush=True)
        if arguments.binary:
            large(path)
            begin = time.monotonic()
            done = subprocess.run([arguments.binary, "check", path], capture_output=True)
            used = os.times()
            print(f"100,000 steps: {os.path.getsize(path) / 1e6:.1f} MB, check ends with {done.returncode} after {time.monotonic() - begin:.2f} s ({used.children_user:.2f} s of CPU)")


if __name__ == "__main__":
    main()

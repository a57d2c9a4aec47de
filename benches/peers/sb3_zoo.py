"""Stable-Baselines3's DQN with its zoo's settings for CartPole-v1 (hyperparams/dqn.yml), scored by our `eval`.

    pip install stable-baselines3 && python benches/peers/sb3_zoo.py FIRST END    # seeds FIRST to END − 1
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import time

import torch
from safetensors.torch import save_file
from stable_baselines3 import DQN

PROGRAM = pathlib.Path(__file__).resolve().parents[2] / "target/release/cartpole-dqn"

torch.set_num_threads(1)
for seed in range(int(sys.argv[1]), int(sys.argv[2])):
    start = time.process_time()
    model = DQN(
        "MlpPolicy", "CartPole-v1", learning_rate=2.3e-3, batch_size=64, buffer_size=100_000, learning_starts=1000,
        gamma=0.99, target_update_interval=10, train_freq=256, gradient_steps=128, exploration_fraction=0.16,
        exploration_final_eps=0.04, policy_kwargs={"net_arch": [256, 256]}, seed=seed, device="cpu",
    )
    model.learn(50_000)
    seconds = time.process_time() - start
    with tempfile.TemporaryDirectory() as directory:
        policy = f"{directory}/policy.safetensors"
        save_file(model.q_net.q_net.state_dict(), policy)
        result = subprocess.run([PROGRAM, "eval", policy, "--json"], capture_output=True, check=True)
    print(f"seed {seed}: {seconds:.1f} CPU s, final mean {json.loads(result.stdout)['mean']}", flush=True)

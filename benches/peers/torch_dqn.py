"""DQN in PyTorch, eager, as CleanRL's dqn.py writes it.

`python torch_dqn.py STEPS` trains with CleanRL's settings for STEPS steps and prints two times as JSON.
"""

import json
import sys
import time

import gymnasium
import numpy as np
import torch
from memory import Memory
from torch import nn
from torch.nn import functional as F

torch.set_num_threads(1)
GAMMA = 0.99


def network(hidden):
    sizes = [4, *hidden, 2]
    layers = [layer for pair in zip(sizes, sizes[1:]) for layer in (nn.Linear(*pair), nn.ReLU())]
    return nn.Sequential(*layers[:-1])


class Learner:
    def __init__(self, hidden, batch, memory, learning_rate=1e-3):
        self.online, self.target = network(hidden), network(hidden)
        self.target.load_state_dict(self.online.state_dict())
        self.optimizer = torch.optim.Adam(self.online.parameters(), lr=learning_rate)
        self.memory, self.batch = memory, batch

    def update(self):
        batch = map(torch.from_numpy, self.memory.sample(self.batch))
        observations, actions, rewards, next_observations, terminated = batch
        with torch.no_grad():
            largest, _ = self.target(next_observations).max(dim=1)
            targets = rewards + GAMMA * largest * (1 - terminated)
        q = self.online(observations).gather(1, actions[:, None]).squeeze()
        loss = F.mse_loss(targets, q)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()


def updates(hidden, batch):
    """A function that does n updates."""
    learner = Learner(hidden, batch, Memory.filled(2000))

    def run(n):
        for _ in range(n):
            learner.update()

    return run


def forwards():
    """A function that does n forwards of one observation through 4-24-24-2."""
    online, observation = network([24, 24]), torch.zeros(1, 4)

    def run(n):
        with torch.no_grad():
            for _ in range(n):
                online(observation)

    return run


def train(steps, warmup=10_000):
    """Seconds of the steps before learning starts and of those after it."""
    environment = gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.make("CartPole-v1"))
    learner = Learner([120, 84], 128, Memory(10_000), learning_rate=2.5e-4)
    rng = np.random.default_rng(1)
    start = time.perf_counter()
    observation, _ = environment.reset(seed=1)
    for step in range(steps):
        if step == warmup:
            learning = time.perf_counter()
        if rng.random() < max(0.05, 1 - 0.95 * step / 250_000):
            action = int(rng.integers(2))
        else:
            with torch.no_grad():
                action = int(learner.online(torch.from_numpy(observation)[None]).argmax(dim=1))
        next_observation, reward, terminated, truncated, _ = environment.step(action)
        learner.memory.push(observation, action, reward, next_observation, terminated)
        observation = environment.reset()[0] if terminated or truncated else next_observation
        if step >= warmup and step % 10 == 0:
            learner.update()
        if step >= warmup and step % 500 == 0:
            learner.target.load_state_dict(learner.online.state_dict())
    return learning - start, time.perf_counter() - learning


if __name__ == "__main__":
    before, after = train(int(sys.argv[1]))
    print(json.dumps({"before_learning": before, "learning": after}))

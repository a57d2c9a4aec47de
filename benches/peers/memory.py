"""Transitions as NumPy arrays, sampled as CleanRL and Stable-Baselines3 do: with replacement."""

import numpy as np


class Memory:
    def __init__(self, capacity, seed=0):
        self.observations = np.zeros((capacity, 4), np.float32)
        self.next_observations = np.zeros((capacity, 4), np.float32)
        self.actions = np.zeros(capacity, np.int64)
        self.rewards = np.zeros(capacity, np.float32)
        self.terminated = np.zeros(capacity, np.float32)
        self.capacity, self.pushed = capacity, 0
        self.rng = np.random.default_rng(seed)

    @classmethod
    def filled(cls, capacity):
        memory = cls(capacity)
        memory.observations[:] = memory.rng.uniform(-1, 1, (capacity, 4))
        memory.next_observations[:] = memory.rng.uniform(-1, 1, (capacity, 4))
        memory.actions[:] = memory.rng.integers(0, 2, capacity)
        memory.rewards[:] = 1
        memory.terminated[::50] = 1
        memory.pushed = capacity
        return memory

    def push(self, observation, action, reward, next_observation, terminated):
        slot = self.pushed % self.capacity
        self.observations[slot], self.next_observations[slot] = observation, next_observation
        self.actions[slot], self.rewards[slot], self.terminated[slot] = action, reward, terminated
        self.pushed += 1

    def sample(self, batch):
        rows = self.rng.integers(0, min(self.pushed, self.capacity), batch)
        return [column[rows] for column in self.columns()]

    def columns(self):
        return self.observations, self.actions, self.rewards, self.next_observations, self.terminated

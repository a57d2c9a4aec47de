"""Steps a second of Gymnasium's environments without their wrappers, at random play with resets: the best of
many short rounds, because another process may have the core in some of them."""

import random
import time

import gymnasium

STEPS = 2_000
ROUNDS = 50

for name in ("CartPole-v1", "Acrobot-v1", "MountainCar-v0"):
    environment = gymnasium.make(name).unwrapped
    choices = random.Random(0).choices(range(environment.action_space.n), k=STEPS)
    environment.reset(seed=0)
    best = 0.0
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for action in choices:
            if environment.step(action)[2]:
                environment.reset()
        best = max(best, STEPS / (time.perf_counter() - start))
    print(f"{name:<15} {best:>9,.0f} steps/s")

"""Gymnasium's CartPole-v1 without its wrappers."""

import gymnasium


def steps():
    """A function that does n steps."""
    environment = gymnasium.make("CartPole-v1").unwrapped

    def run(n):
        environment.reset(seed=0)
        for i in range(n):
            if environment.step(i % 2)[2]:
                environment.reset()

    return run

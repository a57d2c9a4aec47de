"""The mirror image that adapters/gymnasium.py gives of LunarLander-v3 is LunarLander-v3. Needs gymnasium[box2d].

Two environments play mirrored actions with mirrored random numbers. Their observations must be each other's images until a leg
touches the ground: then Box2D solves contacts one after the other, and the order is not mirrored.
"""

import json
import pathlib
import random
import subprocess
import sys

import gymnasium
import numpy

ADAPTER = pathlib.Path(__file__).resolve().parents[2] / "adapters/gymnasium.py"
answer = subprocess.check_output([sys.executable, ADAPTER, "LunarLander-v3"], input=b"hello 1\n")
mirror = json.loads(answer)["mirror"]


class Numbers:
    """The random numbers of one episode. A reset draws 12 heights of the ground, 11 of them from left to right, and a force (x, y);
    a step draws the dispersion of the engines along the lander and across it. x and across change their sign in the image."""

    def __init__(self, seed, is_image):
        self.random, self.is_image, self.drawn = random.Random(seed), is_image, 0

    def uniform(self, low, high, size=None):
        if size:
            heights = [self.random.uniform(low, high) for _ in range(*size)]
            return numpy.array(heights[10::-1] + heights[11:] if self.is_image else heights)
        self.drawn += 1
        is_sideways = self.drawn == 1 or (self.drawn > 2 and self.drawn % 2 == 0)
        number = self.random.uniform(low, high)
        return -number if self.is_image and is_sideways else number


pair = [gymnasium.make("LunarLander-v3", disable_env_checker=True).unwrapped for _ in range(2)]
worst, steps, legs = 0.0, 0, 0
for seed in range(100):
    for env, is_image in zip(pair, [False, True]):
        env._np_random = Numbers(seed, is_image)
    seen, image = [env.reset()[0] for env in pair]
    actions = random.Random(seed)
    ended = False
    while not ended and not seen[6:].any() and not image[6:].any():
        expected = [factor * seen[j] for j, factor in mirror["observation"]]
        worst = max(worst, float(numpy.abs(expected - image).max()))
        action = actions.randrange(4)
        (seen, _, ended, *_), (image, *_) = pair[0].step(action), pair[1].step(mirror["actions"][action])
        steps += 1
    legs += bool(all(seen[j] == image[i] for i, (j, _) in enumerate(mirror["observation"]) if i > 5))
print(f"{steps} steps, largest difference {worst:.2g}; the legs are each other's on the ground in {legs} of 100")
assert steps > 5_000 and worst < 0.02 and legs > 90, "not a mirror image"

"""Any Gymnasium environment with a one-dimensional Box as observation and Discrete actions, as a program for cartpole-dqn:

    "environment": {"command": ["python3", "adapters/gymnasium.py", "LunarLander-v3"]}

docs/environments.md describes the protocol.
"""

import os
import sys

# Standard output is for answers alone. Whatever a library prints goes to standard error, also from C.
answers = os.fdopen(os.dup(1), "wb")
os.dup2(2, 1)
# This file must not be found in the place of the package. A module of one's own may be in the current directory.
sys.path = [path for path in [*sys.path, os.getcwd()] if os.path.abspath(path) != os.path.dirname(os.path.abspath(__file__))]
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import argparse
import base64
import json
import traceback

import gymnasium
import numpy

# Tasks that are their own mirror image, as docs/environments.md describes it. In LunarLander left and right are exchanged: x, the
# horizontal velocity, the angle and its velocity change their sign, and the legs and the side engines change places.
MIRRORS = {
    "LunarLander-v3": {
        "observation": [[0, -1], [1, 1], [2, -1], [3, 1], [4, -1], [5, -1], [7, 1], [6, 1]],
        "actions": [0, 3, 2, 1],
    },
}


def parse():
    parser = argparse.ArgumentParser(description="Answers the requests of cartpole-dqn on standard input.")
    parser.add_argument("id", help='name of the environment, also "module:Name-v0" with a module in the current directory')
    parser.add_argument("--max-steps", type=int, help="steps after which an episode is truncated [default: Gymnasium's]")
    parser.add_argument("--return-range", type=float, nargs=2, metavar=("LOW", "HIGH"), help="returns of an episode")
    parser.add_argument("--kwargs", type=json.loads, default={}, help="more arguments of gymnasium.make, as JSON")
    return parser.parse_args()


class Task:
    def __init__(self, arguments):
        self.arguments = arguments
        self.env = self.make()
        # The same episode in an environment that draws: some environments do more work as soon as they can draw.
        self.drawn = None
        self.seed, self.actions = 0, []
        seen, done = self.env.observation_space, self.env.action_space
        if not isinstance(seen, gymnasium.spaces.Box) or len(seen.shape) != 1:
            raise ValueError(f"the observation space must be a Box of one dimension, and it is {seen}")
        if not isinstance(done, gymnasium.spaces.Discrete):
            raise ValueError(f"the action space must be Discrete, and it is {done}")
        # The id as it is registered: making the environment has imported the module before a colon and chosen the version.
        registered = gymnasium.spec(self.env.spec.id)
        max_steps = arguments.max_steps or registered.max_episode_steps
        if max_steps is None:
            raise ValueError(f"{arguments.id} has no time limit; give one with --max-steps N")
        self.first_action = int(done.start)
        self.hello = {
            "protocol": 1,
            "name": arguments.id,
            "observation_size": seen.shape[0],
            "actions": int(done.n),
            "max_steps": max_steps,
            "solved_return": registered.reward_threshold,
            "return_range": arguments.return_range,
            "steps_per_second": self.env.metadata.get("render_fps"),
            "mirror": MIRRORS.get(self.env.spec.id),
        }

    def make(self, **more):
        # -1: without a time limit. cartpole-dqn keeps it, because training may have another one than evaluation.
        settings = {"max_episode_steps": -1, "disable_env_checker": True, **self.arguments.kwargs, **more}
        return gymnasium.make(self.arguments.id, **settings)

    def reset(self, seed):
        self.seed, self.actions = seed, []
        if self.drawn:
            self.drawn.reset(seed=seed)
        return self.env.reset(seed=seed)[0]

    def step(self, action):
        self.actions.append(action)
        if self.drawn:
            self.drawn.step(action)
        return self.env.step(action)

    def render(self):
        if "rgb_array" not in self.env.metadata.get("render_modes", []):
            return "no frame"
        if not self.drawn:
            self.drawn = self.make(render_mode="rgb_array")
            self.drawn.reset(seed=self.seed)
            for action in self.actions:
                self.drawn.step(action)
        pixels = self.drawn.render()
        height, width, _ = pixels.shape
        return f"frame {width} {height} {base64.b64encode(pixels.astype(numpy.uint8).tobytes()).decode()}"

    def answer(self, request, argument):
        if request == b"step":
            seen, reward, terminated, truncated, _ = self.step(int(argument) + self.first_action)
            return f"step {float(reward)!r} {terminated:d} {truncated:d} {numbers(seen)}"
        if request == b"reset":
            return f"reset {numbers(self.reset(int(argument)))}"
        if request == b"render":
            return self.render()
        if request == b"hello" and argument == b"1":
            return json.dumps(self.hello)
        raise ValueError(f"this adapter does not know the request {request!r} {argument!r}")


def numbers(seen):
    return " ".join(map(repr, seen.tolist()))


def main():
    arguments = parse()
    try:
        task, problem = Task(arguments), None
    except Exception as error:
        task, problem = None, error
    for line in iter(sys.stdin.buffer.readline, b""):
        request, _, argument = line.strip().partition(b" ")
        try:
            if problem:
                raise problem
            text = task.answer(request, argument)
        except Exception as error:
            traceback.print_exc()
            text = "error " + " ".join(f"{type(error).__name__}: {error}".split())
        answers.write(text.encode() + b"\n")
        answers.flush()


main()

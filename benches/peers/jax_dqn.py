"""DQN updates in JAX as one compiled loop (`lax.scan`). The rows of the minibatches are drawn before the loop."""

import os

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from memory import Memory

GAMMA, LEARNING_RATE, BETA1, BETA2, EPSILON = 0.99, 1e-3, 0.9, 0.999, 1e-8


def network(hidden, rng):
    sizes = [4, *hidden, 2]
    limits = [(i, o, 1 / np.sqrt(i)) for i, o in zip(sizes, sizes[1:])]
    draw = lambda limit, shape: jnp.asarray(rng.uniform(-limit, limit, shape), jnp.float32)
    return [(draw(limit, (i, o)), draw(limit, o)) for i, o, limit in limits]


def forward(parameters, x):
    for weight, bias in parameters[:-1]:
        x = jax.nn.relu(x @ weight + bias)
    weight, bias = parameters[-1]
    return x @ weight + bias


def loss(online, target, batch):
    observations, actions, rewards, next_observations, terminated = batch
    targets = rewards + GAMMA * forward(target, next_observations).max(axis=1) * (1 - terminated)
    q = jnp.take_along_axis(forward(online, observations), actions[:, None], axis=1)[:, 0]
    return jnp.mean((q - targets) ** 2)


def adam(step, parameter, gradient, m, v, learning_rate=LEARNING_RATE):
    m = BETA1 * m + (1 - BETA1) * gradient
    v = BETA2 * v + (1 - BETA2) * gradient**2
    scaled = (m / (1 - BETA1**step)) / (jnp.sqrt(v / (1 - BETA2**step)) + EPSILON)
    return parameter - learning_rate * scaled, m, v


def updates(hidden, batch):
    """A function that does n updates; the first call of each n compiles."""
    rng = np.random.default_rng(0)
    online = network(hidden, rng)
    memory = [jnp.asarray(column) for column in Memory.filled(2000).columns()]

    @jax.jit
    def loop(state, target, rows):
        def update(state, rows):
            step, online, m, v = state
            gradient = jax.grad(loss)(online, target, [column[rows] for column in memory])
            new = [adam(step, *leaves) for leaves in zip(*map(jax.tree.leaves, (online, gradient, m, v)))]
            structure = jax.tree.structure(online)
            return (step + 1, *(jax.tree.unflatten(structure, leaves) for leaves in zip(*new))), None

        return lax.scan(update, state, rows)[0]

    zeros = jax.tree.map(jnp.zeros_like, online)
    state = (jnp.float32(1), online, zeros, zeros)

    def run(n):
        nonlocal state
        rows = jnp.asarray(rng.integers(0, 2000, (n, batch)), jnp.int32)
        state = jax.block_until_ready(loop(state, online, rows))

    return run

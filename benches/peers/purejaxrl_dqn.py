"""PureJaxRL's dqn.py (Lu et al. 2022), its own settings: environments, replay memory and learning in one `lax.scan`.

The environment is written as in gymnax, the memory as in flashbax, in own lines: the released gymnax excludes the
Gymnasium that is pinned here, and has another interface than dqn.py calls.

`python purejaxrl_dqn.py [SEED]` trains and prints as JSON the seconds of compiling and of training, and the mean
return in the first and last tenth.
"""

import json
import sys
import time
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax, random
from jax_dqn import GAMMA, adam, forward, loss

# CleanRL's settings. With 10 environments every iteration of the scan makes 10 steps and one update.
STEPS, ENVIRONMENTS, CAPACITY, BATCH, LEARNING_RATE = 500_000, 10, 10_000, 128, 2.5e-4
WARMUP, LEARN_EVERY, TARGET_EVERY = 10_000, 10, 500
EPSILON_INITIAL, EPSILON_FINAL, EPSILON_STEPS = 1.0, 0.05, 250_000
SLOTS = CAPACITY // ENVIRONMENTS


def reset(key):
    return random.uniform(key, (4,), minval=-0.05, maxval=0.05), 0


def step(key, state, action):
    """One step in f32, and the state after it, which is of a new episode if this one is done."""
    (x, x_dot, theta, theta_dot), time = state
    force, sin, cos = 20.0 * action - 10.0, jnp.sin(theta), jnp.cos(theta)
    push = (force + 0.05 * theta_dot**2 * sin) / 1.1
    theta_acc = (9.8 * sin - cos * push) / (0.5 * (4.0 / 3.0 - 0.1 * cos**2 / 1.1))
    x_acc = push - 0.05 * theta_acc * cos / 1.1
    derivative = jnp.array([x_dot, x_acc, theta_dot, theta_acc])
    physics = state[0] + 0.02 * derivative
    done = (abs(physics[0]) > 2.4) | (abs(physics[2]) > 12 * 2 * jnp.pi / 360) | (time + 1 >= 500)
    return jax.tree.map(partial(jnp.where, done), reset(random.split(key)[1]), (physics, time + 1)), 1.0, done


def network(key):
    """4-120-84-2, drawn as flax's Dense does."""
    draw, sizes = jax.nn.initializers.lecun_normal(), [4, 120, 84, 2]
    keys = random.split(key, 3)
    return [(draw(k, (i, o)), jnp.zeros(o)) for k, i, o in zip(keys, sizes, sizes[1:])]


def act(key, online, observations, steps):
    key_action, key_explore = random.split(key)
    epsilon = EPSILON_INITIAL + (EPSILON_FINAL - EPSILON_INITIAL) / EPSILON_STEPS * steps
    explores = random.uniform(key_explore, (ENVIRONMENTS,)) < jnp.maximum(epsilon, EPSILON_FINAL)
    actions = random.randint(key_action, (ENVIRONMENTS,), 0, 2)
    return jnp.where(explores, actions, forward(online, observations).argmax(axis=1))


def sample(key, memory, added):
    """Transitions drawn with replacement; the next observation is that of the environment's next slot."""
    key_slot, key_environment = (random.split(k)[1] for k in (key, random.split(key)[0]))
    held = jnp.minimum(added, SLOTS)
    slots = (added - held + random.randint(key_slot, (BATCH,), 0, held - 1)) % SLOTS
    environments = random.randint(key_environment, (BATCH,), 0, ENVIRONMENTS)
    observations, actions, rewards, done = (column[environments, slots] for column in memory)
    return observations, actions, rewards, memory[0][environments, (slots + 1) % SLOTS], done


def learn(key, learner, memory, added):
    updates, online, target, m, v = learner
    gradient = jax.grad(loss)(online, target, sample(key, memory, added))
    leaves = zip(*map(jax.tree.leaves, (online, gradient, m, v)))
    new = zip(*(adam(updates + 1.0, *each, learning_rate=LEARNING_RATE) for each in leaves))
    online, m, v = (jax.tree.unflatten(jax.tree.structure(online), leaves) for leaves in new)
    return updates + 1, online, target, m, v


def iteration(state, _):
    """A step of every environment, an update if due; the metrics are PureJaxRL's."""
    learner, memory, environments, returns, last_returns, added, key = state
    key, key_act, key_step, key_learn = random.split(key, 4)
    observations, _ = environments
    actions = act(key_act, learner[1], observations, added * ENVIRONMENTS)
    keys = random.split(key_step, ENVIRONMENTS)
    environments, rewards, done = jax.vmap(step)(keys, environments, actions)
    transition = (observations, actions, rewards, done)
    memory = [column.at[:, added % SLOTS].set(values) for column, values in zip(memory, transition)]
    added = added + 1
    returns = returns + rewards
    last_returns = jnp.where(done, returns, last_returns)
    steps = added * ENVIRONMENTS
    due = (added >= BATCH // ENVIRONMENTS + 1) & (steps > WARMUP) & (steps % LEARN_EVERY == 0)
    learner = lax.cond(due, learn, lambda _key, learner, *_: learner, key_learn, learner, memory, added)
    updates, online, target, *moments = learner
    target = lax.cond(steps % TARGET_EVERY == 0, lambda: online, lambda: target)
    state = ((updates, online, target, *moments), memory, environments, returns * ~done, last_returns, added, key)
    return state, last_returns.mean()


@jax.jit
def train(key):
    """Updates done, and the mean of the environments' last returns after every iteration."""
    key, key_reset, key_network = random.split(key, 3)
    online = network(key_network)
    zeros = jax.tree.map(jnp.zeros_like, online)
    table = lambda dtype, *shape: jnp.zeros((ENVIRONMENTS, SLOTS, *shape), dtype)
    memory = [table(jnp.float32, 4), table(jnp.int32), table(jnp.float32), table(bool)]
    environments = jax.vmap(reset)(random.split(key_reset, ENVIRONMENTS))
    none = jnp.zeros(ENVIRONMENTS)
    state = ((0, online, online, zeros, zeros), memory, environments, none, none, 0, key)
    (learner, *_), returns = lax.scan(iteration, state, None, STEPS // ENVIRONMENTS)
    return learner[0], returns


if __name__ == "__main__":
    key = random.key(int(sys.argv[1]) if sys.argv[1:] else 0)
    start = time.perf_counter()
    compiled = train.lower(key).compile()
    compiling = time.perf_counter() - start
    start = time.perf_counter()
    updates, returns = jax.block_until_ready(compiled(key))
    training = time.perf_counter() - start
    tenth = len(returns) // 10
    learned = {"first_tenth": float(returns[:tenth].mean()), "last_tenth": float(returns[-tenth:].mean())}
    assert learned["last_tenth"] > 4 * learned["first_tenth"], learned
    print(json.dumps({"compiling": compiling, "training": training, "updates": int(updates), **learned}))

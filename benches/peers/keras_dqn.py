"""DQN in Keras: the fastest loop, a custom `tf.function`, and the tutorial's, `predict` and `fit` per transition."""

import os

os.environ["CUDA_VISIBLE_DEVICES"] = "-1"
os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"

import time

import gymnasium
import keras
import numpy as np
import tensorflow as tf
from memory import Memory

tf.config.threading.set_intra_op_parallelism_threads(1)
tf.config.threading.set_inter_op_parallelism_threads(1)
GAMMA = 0.95


def network(hidden):
    layers = [keras.layers.Dense(units, activation="relu") for units in hidden]
    return keras.Sequential([keras.Input((4,)), *layers, keras.layers.Dense(2, activation="linear")])


def learner(hidden, memory, batch):
    """The online network and a function that does one update."""
    online, target = network(hidden), network(hidden)
    target.set_weights(online.get_weights())
    optimizer = keras.optimizers.Adam(1e-3)
    optimizer.build(online.trainable_variables)

    @tf.function
    def step(observations, actions, rewards, next_observations, terminated):
        targets = rewards + GAMMA * tf.reduce_max(target(next_observations), axis=1) * (1 - terminated)
        with tf.GradientTape() as tape:
            q = tf.gather(online(observations), actions, axis=1, batch_dims=1)
            loss = tf.reduce_mean((q - targets) ** 2)
        gradients = tape.gradient(loss, online.trainable_variables)
        optimizer.apply_gradients(zip(gradients, online.trainable_variables))

    return online, lambda: step(*map(tf.constant, memory.sample(batch)))


def updates(hidden, batch):
    """A function that does n updates."""
    _, update = learner(hidden, Memory.filled(2000), batch)

    def run(n):
        for _ in range(n):
            update()

    return run


def play(act, learn, memory, seconds):
    """Steps per second of a training loop that learns after every step, over at least so many seconds."""
    environment, rng, epsilon = gymnasium.make("CartPole-v1"), np.random.default_rng(0), 1.0
    observation, _ = environment.reset(seed=0)
    steps, start = 0, None
    while start is None or time.perf_counter() - start < seconds:
        action = int(rng.integers(2)) if rng.random() <= epsilon else act(observation)
        next_observation, reward, terminated, truncated, _ = environment.step(action)
        memory.push(observation, action, reward, next_observation, terminated or truncated)
        observation = next_observation
        if terminated or truncated:
            observation, epsilon = environment.reset()[0], max(0.01, epsilon * 0.995)
        if memory.pushed >= 32:
            learn()
            # What is compiled with the first learning step is not counted.
            start, steps = (start, steps + 1) if start else (time.perf_counter(), 0)
    return steps / (time.perf_counter() - start)


def compiled_loop(seconds=10):
    """Steps per second of the tutorial's network with one compiled update of a minibatch every step."""
    memory = Memory(2000)
    online, update = learner([24, 24], memory, 32)
    q_values = tf.function(online)
    act = lambda observation: int(np.argmax(q_values(tf.constant(observation[None]))))
    return play(act, update, memory, seconds)


def tutorial_loop(seconds=20):
    """Steps per second of the tutorial as published: 32 times `predict`, `predict` and `fit` every step."""
    memory = Memory(2000)
    online, target = network([24, 24]), network([24, 24])
    online.compile(loss="mse", optimizer=keras.optimizers.Adam(1e-3))

    def learn():
        for observation, action, reward, next_observation, terminated in zip(*memory.sample(32)):
            q = online.predict(observation[None], verbose=0)
            future = target.predict(next_observation[None], verbose=0)
            q[0][action] = reward if terminated else reward + GAMMA * np.amax(future[0])
            online.fit(observation[None], q, epochs=1, verbose=0)

    act = lambda observation: int(np.argmax(online.predict(observation[None], verbose=0)))
    return play(act, learn, memory, seconds)

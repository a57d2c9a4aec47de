"""tests/check/keras_update.py --binary FILE: a DQN update in Keras, written with `save_update` of the Python module, right and
with planted mistakes. Needs tensorflow and keras."""

import argparse
import pathlib
import sys
import tempfile

import keras
import numpy as np
import tensorflow as tf

from planted import explained, random_batch, save_update, verdict

GAMMA = 0.9


def network():
    layers = [keras.layers.Dense(24, activation="relu"), keras.layers.Dense(24, activation="relu"), keras.layers.Dense(2)]
    model = keras.Sequential([keras.Input((4,)), *layers])
    return model


def update(batch, online, target, optimizer, mistake):
    s, s2, r = batch["observations"], batch["next_observations"], batch["rewards"]
    d = batch["terminated"].astype(np.float32)
    mask = np.ones_like(d) if mistake == "terminal_bootstrapped" else 1 - d
    with tf.GradientTape() as tape:
        y = r + GAMMA * mask * tf.reduce_max(target(s2), 1)
        q = online(s)
        chosen = tf.reduce_sum(q * tf.one_hot(batch["actions"], 2), 1)
        if mistake == "mean_over_outputs":
            full = q.numpy()
            full[np.arange(len(r)), batch["actions"]] = y.numpy()
            loss = tf.reduce_mean((q - full) ** 2)
        elif mistake == "every_pair":
            loss = tf.reduce_mean((chosen[:, None] - y) ** 2)
        else:
            loss = tf.reduce_mean((chosen - tf.stop_gradient(y)) ** 2)
    gradients = tape.gradient(loss, online.trainable_variables)
    optimizer.apply_gradients(zip(gradients, online.trainable_variables))
    return y, loss, gradients


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", required=True)
    binary = parser.parse_args().binary
    path = str(pathlib.Path(tempfile.mkdtemp()) / "update.safetensors")
    rng = np.random.default_rng(0)
    for mistake in [None, "terminal_bootstrapped", "mean_over_outputs", "every_pair", "weight_decay"]:
        online, target = network(), network()
        optimizer = keras.optimizers.Adam(1e-3) if mistake != "weight_decay" else keras.optimizers.AdamW(1e-3, weight_decay=0.01)
        for _ in range(3):
            update(random_batch(rng, 32, 4, 2), online, target, optimizer, mistake)
        batch = random_batch(rng, 32, 4, 2)
        run = lambda: update(batch, online, target, optimizer, mistake)
        save_update(path, online, target, optimizer, batch, run, gamma=GAMMA, learning_rate=1e-3)
        code, found = verdict(binary, path)
        good = frozenset([mistake]) in explained(found) if mistake else code == 0
        print(mistake or "right", "->", [sorted(names) for names in explained(found)] or "equal")
        if not good:
            sys.exit(f"{mistake}: {found}")


if __name__ == "__main__":
    main()

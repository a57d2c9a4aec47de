"""tests/check/jax_update.py --binary FILE: a DQN update in JAX and optax, written with `save_update` of the Python module, right
and with planted mistakes. Needs jax and optax."""

import argparse
import pathlib
import sys
import tempfile

import jax
import jax.numpy as jnp
import numpy as np
import optax

from planted import explained, random_batch, save_update, verdict

GAMMA = 0.9


def network(key):
    """Flax's tree: kernel and bias by name."""
    params = {}
    for layer, (inputs, outputs) in enumerate([(4, 24), (24, 24), (24, 2)]):
        key, drawn = jax.random.split(key)
        kernel = jax.random.normal(drawn, (inputs, outputs)) / inputs**0.5
        params[f"Dense_{layer}"] = {"kernel": kernel, "bias": jnp.full(outputs, 0.1)}
    return params


def q_values(params, x):
    for layer in range(3):
        x = x @ params[f"Dense_{layer}"]["kernel"] + params[f"Dense_{layer}"]["bias"]
        x = jax.nn.relu(x) if layer < 2 else x
    return x


def update(batch, params, target, optimizer, opt_state, mistake):
    next_params = params if mistake == "gradient_through_target" else target

    def targets(params):
        mask = batch["terminated"] if mistake == "mask_inverted" else 1 - batch["terminated"]
        return batch["rewards"] + GAMMA * mask * q_values(params, batch["next_observations"]).max(1)

    def loss(params):
        chosen = q_values(params, batch["observations"])[jnp.arange(len(batch["actions"])), batch["actions"]]
        y = targets(params) if mistake == "gradient_through_target" else targets(next_params)
        errors = optax.l2_loss(chosen, y) if mistake == "half_square" else optax.squared_error(chosen, y)
        return errors.mean()

    value, gradients = jax.value_and_grad(loss)(params)
    updates, opt_state = optimizer.update(gradients, opt_state, params)
    return targets(next_params), value, gradients, optax.apply_updates(params, updates), opt_state


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", required=True)
    binary = parser.parse_args().binary
    path = str(pathlib.Path(tempfile.mkdtemp()) / "update.safetensors")
    rng = np.random.default_rng(0)
    for mistake in [None, "mask_inverted", "half_square", "gradient_through_target", "weight_decay_of_optax"]:
        params, target = network(jax.random.key(1)), network(jax.random.key(2))
        optimizer = optax.adamw(1e-3) if mistake == "weight_decay_of_optax" else optax.adam(1e-3)
        opt_state = optimizer.init(params)
        for _ in range(3):
            *_, params, opt_state = update(random_batch(rng, 32, 4, 2), params, target, optimizer, opt_state, mistake)
        batch = random_batch(rng, 32, 4, 2)
        run = lambda: update(batch, params, target, optimizer, opt_state, mistake)[:4]
        has_target = mistake != "gradient_through_target"
        save_update(path, params, target if has_target else None, opt_state, batch, run, gamma=GAMMA)
        code, found = verdict(binary, path)
        good = frozenset([mistake]) in explained(found) if mistake else code == 0
        print(mistake or "right", "->", [sorted(names) for names in explained(found)] or "equal")
        if not good:
            sys.exit(f"{mistake}: {found}")


if __name__ == "__main__":
    main()

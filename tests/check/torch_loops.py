"""Right DQN loops as people write them in PyTorch, Stable-Baselines3, Keras and JAX, recorded with `cartpole_dqn.Recorder`.
right_loops.py runs them."""

import copy
import os
import pathlib
import sys

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.nn import functional

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "python"))
from cartpole_dqn import Recorder  # noqa: E402

torch.set_num_threads(1)


class Memory:
    """A ring of transitions, sampled uniformly or by priority."""

    def __init__(self, capacity, features, rng, prioritised):
        self.capacity, self.rng, self.prioritised, self.length, self.place = capacity, rng, prioritised, 0, 0
        self.columns = {
            "observations": np.zeros((capacity, features), np.float32), "next_observations": np.zeros((capacity, features), np.float32),
            "actions": np.zeros(capacity, np.int64), "rewards": np.zeros(capacity, np.float32), "terminated": np.zeros(capacity, np.float32),
            "truncated": np.zeros(capacity, np.float32), "discounts": np.zeros(capacity, np.float32),
        }  # fmt: skip
        self.priorities = np.zeros(capacity)

    def append(self, **row):
        for name, value in row.items():
            self.columns[name][self.place] = value
        self.priorities[self.place] = self.priorities.max() or 1.0
        self.place, self.length = (self.place + 1) % self.capacity, min(self.length + 1, self.capacity)

    def sample(self, size):
        shares = self.priorities[: self.length] ** 0.6 / (self.priorities[: self.length] ** 0.6).sum() if self.prioritised else None
        self.chosen = self.rng.choice(self.length, size, p=shares)
        batch = {name: torch.as_tensor(column[self.chosen]) for name, column in self.columns.items()}
        if self.prioritised:
            weights = (self.length * shares[self.chosen]) ** -0.4
            batch["weights"] = torch.as_tensor(weights / weights.max(), dtype=torch.float32)
        return batch


def network(features, actions, hidden=(64, 64), activation=nn.ReLU):
    layers, sizes = [], [features, *hidden, actions]
    for inputs, outputs in zip(sizes, sizes[1:]):
        layers += [nn.Linear(inputs, outputs), activation()]
    return nn.Sequential(*layers[:-1])


class Learner:
    """Two networks, an optimiser and an update."""

    def __init__(self, features, actions, option):
        self.option = option
        self.online = network(features, actions, option.get("hidden", (64, 64)), option.get("activation", nn.ReLU))
        self.target = copy.deepcopy(self.online) if option.get("target", "hard") else None
        kind, arguments = option.get("optimizer", ("Adam", {"lr": 1e-3}))
        self.optimizer = getattr(torch.optim, kind)(self.online.parameters(), **arguments)
        self.updates = 0

    def update(self, batch):
        option = self.option
        with torch.no_grad():
            q = (self.online if self.target is None else self.target)(batch["next_observations"])
            best = (self.online(batch["next_observations"]) if option.get("double") else q).argmax(1, keepdim=True)
            y = batch["rewards"] + batch["discounts"] * (1 - batch["terminated"]) * q.gather(1, best)[:, 0]
        error = self.online(batch["observations"]).gather(1, batch["actions"][:, None])[:, 0]
        losses = (functional.smooth_l1_loss if option.get("loss") == "huber" else functional.mse_loss)(error, y, reduction="none")
        loss = (losses * batch.get("weights", 1)).mean()
        self.optimizer.zero_grad()
        loss.backward()
        if "clip_value" in option:
            nn.utils.clip_grad_value_(self.online.parameters(), option["clip_value"])
        if "max_gradient_norm" in option:
            nn.utils.clip_grad_norm_(self.online.parameters(), option["max_gradient_norm"])
        self.optimizer.step()
        self.updates += 1
        kind = option.get("target", "hard")
        if kind == "soft":
            tau = option.get("tau", 0.005)
            with torch.no_grad():
                for t, w in zip(self.target.parameters(), self.online.parameters()):
                    t.lerp_(w, tau)
        elif kind == "hard" and self.updates % option.get("period", 200) == 0:
            self.target.load_state_dict(self.online.state_dict())
        return y, loss.detach(), (error - y).detach().abs().numpy()


def epsilon_of(kind, step, steps, episode):
    share = min(step / (0.4 * steps), 1)
    return {"linear": 1 - 0.95 * share, "tutorial": 0.05 + 0.85 * np.exp(-step / 1000), "constant": 0.1, "per episode": max(0.01, 0.98**episode),
            "cleanrl": max(0.05, 1 - 0.95 * step / (0.5 * steps))}[kind]  # fmt: skip


def make(option):
    env = gymnasium.make(option.get("task", "CartPole-v1"), max_episode_steps=option.get("limit"), **option.get("arguments", {}))
    for wrapper in option.get("wrappers", ()):
        env = wrapper(env)
    return env


def loop(path, seed, steps, **option):
    """A loop with one environment; `recorder.environment` is its outermost wrapper."""
    torch.manual_seed(seed)
    rng, gamma, n = np.random.default_rng([seed, 7]), option.get("gamma", 0.99), option.get("n", 1)
    told = {name: option[name] for name in ("loss", "double", "clip_value", "max_gradient_norm") if name in option}
    recorder = Recorder(path, gamma=gamma, **told)
    env = recorder.environment(make(option))
    features, actions = env.observation_space.shape[0], int(env.action_space.n)
    learner = Learner(features, actions, option)
    memory = Memory(option.get("capacity", 10_000), features, rng, option.get("prioritised"))
    warm_up, every, size = option.get("warm_up", 200), option.get("every", 1), option.get("size", 32)
    observation, _ = env.reset(seed=seed)
    window, episode = [], 0
    for step in range(steps):
        with torch.no_grad():
            q = learner.online(torch.as_tensor(observation[None], dtype=torch.float32))[0]
        epsilon = epsilon_of(option.get("epsilon", "linear"), step, steps, episode)
        if option.get("policy") == "softmax":
            action = int(rng.choice(actions, p=torch.softmax(q.double(), 0).numpy()))
            recorder.acting(q_values=q)
        else:
            is_random = step < option.get("random_until", 0) or rng.random() < epsilon
            action = int(rng.integers(actions)) if is_random else int(q.argmax())
            recorder.acting(q, 1.0 if step < option.get("random_until", 0) else epsilon)
        following, reward, terminated, truncated, _ = env.step(action)
        # n steps: each row has the rewards until its end, and the discount of what follows.
        window.append({"observations": observation, "actions": action, "rewards": 0.0, "discounts": 1.0})
        for row in window:
            row["rewards"] += row["discounts"] * option.get("reward", float)(reward)
            row["discounts"] *= gamma
            row.update(next_observations=following, terminated=terminated, truncated=truncated)
        ended = terminated or truncated
        done = window if ended else window[:1] if len(window) == n else []
        for row in done:
            memory.append(**{**row, **({"next_observations": 0.0} if option.get("final_zeros") and row["terminated"] else {})})
        window = [] if ended else window[1:] if done else window
        observation = following
        if ended:
            episode += 1
            observation, _ = env.reset()
        if option.get("evaluates") and step % 500 == 499:
            evaluate(recorder.environment(make(option)) if option["evaluates"] == "recorded" else make(option), learner, recorder, seed)
        due = option.get("updates", 1) if step >= max(warm_up, size) and step % every == 0 else 0
        if option.get("at_ends"):
            due = min(len(done), 1) * ended * 30 if step >= warm_up else 0
        for _ in range(due):
            batch = memory.sample(size)
            y, loss, errors = learner.update(batch)
            if option.get("prioritised"):
                memory.priorities[memory.chosen] = errors + 1e-3
            optimizer = {"optimizer": learner.optimizer} if option.get("gives_optimizer", True) else {}
            recorder.learned(online=learner.online, target=learner.target, batch=batch, targets=y, loss=loss, **optimizer)
    recorder.close()


def evaluate(env, learner, recorder, seed):
    observation, _ = env.reset(seed=1000 + seed)
    for _ in range(200):
        with torch.no_grad():
            q = learner.online(torch.as_tensor(observation[None]))[0]
        recorder.acting(q, 0.0)
        observation, _, terminated, truncated, _ = env.step(int(q.argmax()))
        if terminated or truncated:
            return


def vector(path, seed, steps, mode="SAME_STEP", count=4, asynchronous=False, **option):
    """A loop like CleanRL's, with several environments, in each of Gymnasium's ways to reset them."""
    torch.manual_seed(seed)
    rng, gamma = np.random.default_rng([seed, 8]), option.get("gamma", 0.99)
    recorder = Recorder(path, gamma=gamma)
    kind = gymnasium.vector.AsyncVectorEnv if asynchronous else gymnasium.vector.SyncVectorEnv
    envs = kind([lambda: make(option)] * count, autoreset_mode=getattr(gymnasium.vector.AutoresetMode, mode))
    envs = recorder.environment(envs)
    features, actions = envs.single_observation_space.shape[0], int(envs.single_action_space.n)
    learner, memory = Learner(features, actions, option), Memory(10_000, features, rng, False)
    observations, _ = envs.reset(seed=seed)
    over = np.zeros(count, bool)
    for step in range(steps // count):
        epsilon = epsilon_of(option.get("epsilon", "cleanrl"), step, steps // count, 0)
        with torch.no_grad():
            q = learner.online(torch.as_tensor(observations, dtype=torch.float32))
        chosen = np.where(rng.random(count) < epsilon, rng.integers(actions, size=count), q.argmax(1).numpy())
        recorder.acting(q, epsilon)
        following, rewards, terminated, truncated, infos = envs.step(chosen)
        for i in range(count):
            if mode == "NEXT_STEP" and over[i]:
                continue
            last = infos["final_obs"][i] if mode == "SAME_STEP" and (terminated | truncated)[i] else following[i]
            memory.append(observations=observations[i], next_observations=last, actions=chosen[i], rewards=rewards[i],
                          terminated=terminated[i], truncated=truncated[i], discounts=gamma)  # fmt: skip
        over, observations = terminated | truncated, following
        if mode == "DISABLED" and over.any():
            observations, _ = envs.reset(options={"reset_mask": over})
        if memory.length >= 200 and step % option.get("every", 1) == 0:
            batch = memory.sample(option.get("size", 64))
            y, loss, _ = learner.update(batch)
            recorder.learned(online=learner.online, target=learner.target, batch=batch, targets=y, loss=loss, optimizer=learner.optimizer)
    envs.close()
    recorder.close()


def stable_baselines3(path, seed, steps, **arguments):
    """Stable-Baselines3's DQN: its memory and optimiser tell what each update used."""
    import stable_baselines3

    task = arguments.pop("task", "CartPole-v1")
    recorder = Recorder(path, gamma=arguments.get("gamma", 0.99), loss="huber", max_gradient_norm=arguments.get("max_grad_norm", 10))
    env = recorder.environment(gymnasium.make(task))
    model = stable_baselines3.DQN("MlpPolicy", env, seed=seed, device="cpu", **{"learning_starts": 200, **arguments})
    sampled, sample = [], model.replay_buffer.sample
    model.replay_buffer.sample = lambda *given, **named: sampled.append(sample(*given, **named)) or sampled[-1]

    def learned(*_):
        rows = sampled[-1]
        batch = {"observations": rows.observations, "actions": rows.actions, "rewards": rows.rewards, "next_observations": rows.next_observations, "terminated": rows.dones}
        recorder.learned(online=model.q_net, target=model.q_net_target, batch=batch, optimizer=model.policy.optimizer)
        sampled.clear()

    model.policy.optimizer.register_step_post_hook(learned)
    model.learn(steps)
    recorder.close()


def keras_loop(path, seed, steps, **option):
    """A loop like that of Keras tutorials: a full target vector, ε for each episode, a copy of the weights now and then."""
    os.environ.setdefault("KERAS_BACKEND", "torch")
    import keras

    keras.utils.set_random_seed(seed)
    rng, gamma = np.random.default_rng(seed), 0.95
    recorder = Recorder(path, gamma=gamma)
    env = recorder.environment(gymnasium.make("CartPole-v1", max_episode_steps=option.get("limit")))
    dense = keras.layers.Dense
    build = lambda: keras.Sequential([keras.Input((4,)), dense(24, activation="relu"), dense(24, activation="relu"), dense(2)])
    online, target, optimizer = build(), build(), keras.optimizers.Adam(1e-3)
    target.set_weights(online.get_weights())
    memory, epsilon, updates = Memory(2000, 4, rng, False), 1.0, 0
    observation, _ = env.reset(seed=seed)
    for step in range(steps):
        q = keras.ops.convert_to_numpy(online(observation[None]))[0]
        action = int(rng.integers(2)) if rng.random() < epsilon else int(q.argmax())
        recorder.acting(q, epsilon)
        following, reward, terminated, truncated, _ = env.step(action)
        memory.append(observations=observation, next_observations=following, actions=action, rewards=reward, terminated=terminated, truncated=truncated, discounts=gamma)
        observation = following
        if terminated or truncated:
            epsilon = max(0.01, epsilon * 0.97)
            observation, _ = env.reset()
        if step < 64 or step % option.get("every", 4):
            continue
        batch = memory.sample(32)
        y = batch["rewards"] + gamma * (1 - batch["terminated"]) * target(batch["next_observations"]).detach().max(1)[0]
        online.zero_grad()
        chosen = online(batch["observations"]).gather(1, batch["actions"][:, None])[:, 0]
        loss = ((chosen - y) ** 2).mean()
        loss.backward()
        with torch.no_grad():
            optimizer.apply([v.value.grad for v in online.trainable_variables], online.trainable_variables)
        updates += 1
        if updates % 100 == 0:
            target.set_weights(online.get_weights())
        batch = {name: column.numpy() for name, column in batch.items()}
        recorder.learned(online=online, target=target, batch=batch, targets=y.detach(), loss=loss.detach(), optimizer=optimizer)
    recorder.close()


def jax_loop(path, seed, steps, **option):
    """A loop in JAX and optax."""
    import jax
    import jax.numpy as jnp
    import optax

    rng, gamma, recorder = np.random.default_rng(seed), 0.99, Recorder(path, gamma=0.99, learning_rate=1e-3)
    env = recorder.environment(gymnasium.make("CartPole-v1", max_episode_steps=option.get("limit")))
    sizes = (4, 32, 32, 2)
    online = {f"Dense_{i}": {"kernel": jnp.asarray(rng.normal(0, 1 / a**0.5, (a, b)), jnp.float32), "bias": jnp.zeros(b)} for i, (a, b) in enumerate(zip(sizes, sizes[1:]))}
    target, optimizer = online, optax.adam(1e-3)
    state = optimizer.init(online)

    def q_of(network, x):
        for i in range(2):
            x = jax.nn.relu(x @ network[f"Dense_{i}"]["kernel"] + network[f"Dense_{i}"]["bias"])
        return x @ network["Dense_2"]["kernel"] + network["Dense_2"]["bias"]

    def loss_of(network, batch, y):
        return ((q_of(network, batch["observations"])[jnp.arange(len(y)), batch["actions"]] - y) ** 2).mean()

    @jax.jit
    def update(online, target, state, batch):
        y = batch["rewards"] + gamma * (1 - batch["terminated"]) * q_of(target, batch["next_observations"]).max(1)
        loss, gradients = jax.value_and_grad(loss_of)(online, batch, y)
        steps, state = optimizer.update(gradients, state)
        return optax.apply_updates(online, steps), state, y, loss

    act, memory = jax.jit(q_of), Memory(5000, 4, rng, False)
    observation, _ = env.reset(seed=seed)
    for step in range(steps):
        q = np.asarray(act(online, observation))
        epsilon = epsilon_of("linear", step, steps, 0)
        action = int(rng.integers(2)) if rng.random() < epsilon else int(q.argmax())
        recorder.acting(q, epsilon)
        following, reward, terminated, truncated, _ = env.step(action)
        memory.append(observations=observation, next_observations=following, actions=action, rewards=reward, terminated=terminated, truncated=truncated, discounts=gamma)
        observation = env.reset()[0] if terminated or truncated else following
        if step < 200 or step % option.get("every", 1):
            continue
        batch = {name: jnp.asarray(column.numpy()) for name, column in memory.sample(32).items()}
        online, state, y, loss = update(online, target, state, batch)
        if option.get("soft"):
            target = jax.tree.map(lambda t, w: t + 0.01 * (w - t), target, online)
        elif step % 200 == 0:
            target = online
        recorder.learned(online=online, target=target, batch=batch, targets=y, loss=loss, optimizer=state)
    recorder.close()


class FirstOfTwo(gymnasium.Wrapper):
    """Every action is done twice."""

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        if not (terminated or truncated):
            observation, more, terminated, truncated, info = self.env.step(action)
            reward += more
        return observation, reward, terminated, truncated, info


wrappers = gymnasium.wrappers
TUTORIAL = {"optimizer": ("AdamW", {"lr": 3e-4, "amsgrad": True}), "loss": "huber", "clip_value": 100, "target": "soft", "epsilon": "tutorial",
            "size": 128, "warm_up": 128, "hidden": (128, 128)}  # fmt: skip
CLEANRL = {"task": "CartPole-v1", "count": 1, "every": 10, "size": 128, "hidden": (120, 84), "optimizer": ("Adam", {"lr": 2.5e-4}), "period": 50}
# A loop's name: which function, and its options.
LOOPS = {
    "plain": (loop, {}), "PyTorch's tutorial": (loop, TUTORIAL), "PyTorch's tutorial, zeros behind ends": (loop, TUTORIAL | {"final_zeros": True}),
    "the tutorial of docs/from_keras.md": (loop, {"gamma": 0.95, "hidden": (24, 24), "capacity": 2000, "epsilon": "per episode", "warm_up": 32}),
    "no target network": (loop, {"target": None}), "optimiser not given": (loop, {"gives_optimizer": False}),
    "Double": (loop, {"double": True}), "Double, huber, soft": (loop, {"double": True, "loss": "huber", "target": "soft"}),
    "3 steps": (loop, {"n": 3}), "5 steps, Double, limit 50": (loop, {"n": 5, "double": True, "limit": 50}), "10 steps, prioritised": (loop, {"n": 10, "prioritised": True}),
    "prioritised": (loop, {"prioritised": True}), "prioritised, huber, norm": (loop, {"prioritised": True, "loss": "huber", "max_gradient_norm": 1.0, "limit": 60}),
    "soft, τ 0.05": (loop, {"target": "soft", "tau": 0.05}), "soft, τ 0.5 (fast)": (loop, {"target": "soft", "tau": 0.5}), "copy every 20": (loop, {"period": 20}),
    "copy every 900": (loop, {"period": 900}), "RMSprop": (loop, {"optimizer": ("RMSprop", {"lr": 5e-4})}), "SGD, momentum": (loop, {"optimizer": ("SGD", {"lr": 1e-3, "momentum": 0.9})}),
    "NAdam": (loop, {"optimizer": ("NAdam", {"lr": 1e-3})}), "rate 0.1": (loop, {"optimizer": ("Adam", {"lr": 0.1})}), "rate 1e-6": (loop, {"optimizer": ("Adam", {"lr": 1e-6})}),
    "every 4 steps": (loop, {"every": 4, "period": 50}), "4 updates per step, every 4": (loop, {"every": 4, "updates": 4}), "many updates at ends": (loop, {"at_ends": True}),
    "limit 20": (loop, {"limit": 20}), "limit 200, small memory": (loop, {"limit": 200, "capacity": 300}), "softmax policy": (loop, {"policy": "softmax"}),
    "constant ε": (loop, {"epsilon": "constant"}), "random at first, then constant ε": (loop, {"epsilon": "constant", "random_until": 800, "warm_up": 800}),
    "tanh": (loop, {"activation": nn.Tanh}), "leaky ReLU": (loop, {"activation": nn.LeakyReLU}), "one hidden layer": (loop, {"hidden": (128,)}), "linear": (loop, {"hidden": ()}),
    "evaluated elsewhere": (loop, {"evaluates": "elsewhere"}), "evaluation recorded too": (loop, {"evaluates": "recorded", "limit": 100}),
    "γ 1, limit 100": (loop, {"gamma": 1.0, "limit": 100}), "γ 0.5": (loop, {"gamma": 0.5}), "batch of 8": (loop, {"size": 8}), "batch of 256": (loop, {"size": 256, "warm_up": 600, "every": 4}),
    "rewards times 10": (loop, {"reward": lambda r: 10 * r}), "rewards clipped": (loop, {"reward": np.sign, "task": "Acrobot-v1"}), "reward −10 at ends": (loop, {"wrappers": [lambda env: PunishedEnd(env)]}),
    "scaled observations": (loop, {"wrappers": [lambda env: wrappers.RescaleObservation(Bounded(env), np.float32(-1), np.float32(1))]}),
    "normalised observations": (loop, {"wrappers": [wrappers.NormalizeObservation]}), "time in the observation": (loop, {"wrappers": [wrappers.TimeAwareObservation], "limit": 100}),
    "every action twice": (loop, {"wrappers": [FirstOfTwo]}), "4 frames": (loop, {"wrappers": [lambda env: wrappers.FlattenObservation(wrappers.FrameStackObservation(env, 4))]}),
    "statistics": (loop, {"wrappers": [wrappers.RecordEpisodeStatistics]}), "Acrobot": (loop, {"task": "Acrobot-v1"}), "MountainCar": (loop, {"task": "MountainCar-v0"}),
    "LunarLander": (loop, {"task": "LunarLander-v3"}), "LunarLander, 3 steps": (loop, {"task": "LunarLander-v3", "n": 3, "target": "soft"}),
    "FrozenLake, one-hot": (loop, {"task": "FrozenLake-v1", "wrappers": [wrappers.FlattenObservation]}), "CliffWalking, one-hot": (loop, {"task": "CliffWalking-v1", "limit": 100, "wrappers": [wrappers.FlattenObservation]}),
    "Taxi, one-hot": (loop, {"task": "Taxi-v4", "wrappers": [wrappers.FlattenObservation], "size": 16, "every": 4}),
    "CleanRL": (vector, CLEANRL), "CleanRL, Acrobot": (vector, CLEANRL | {"task": "Acrobot-v1"}), "vector, same step": (vector, {}), "vector, next step": (vector, {"mode": "NEXT_STEP"}),
    "vector, disabled": (vector, {"mode": "DISABLED"}), "vector, 16, limit 30": (vector, {"count": 16, "limit": 30}), "vector, next step, limit 20": (vector, {"mode": "NEXT_STEP", "limit": 20}),
    "vector, disabled, limit 20": (vector, {"mode": "DISABLED", "limit": 20, "target": "soft"}), "vector, LunarLander": (vector, {"task": "LunarLander-v3"}), "vector, processes": (vector, {"asynchronous": True}),
    "Stable-Baselines3": (stable_baselines3, {}), "Stable-Baselines3, rl-zoo": (stable_baselines3, {"learning_rate": 2.3e-3, "batch_size": 64, "gamma": 0.99, "target_update_interval": 10, "train_freq": 256, "gradient_steps": 128, "exploration_fraction": 0.16, "exploration_final_eps": 0.04}),
    "Stable-Baselines3, Acrobot": (stable_baselines3, {"task": "Acrobot-v1", "train_freq": 4, "target_update_interval": 250}),
    "Stable-Baselines3, MountainCar": (stable_baselines3, {"task": "MountainCar-v0", "train_freq": 16, "gradient_steps": 8, "learning_rate": 4e-3, "target_update_interval": 600, "gamma": 0.98}),
    "Keras": (keras_loop, {}), "Keras, limit 30": (keras_loop, {"limit": 30}), "JAX": (jax_loop, {}), "JAX, soft, limit 30": (jax_loop, {"soft": True, "limit": 30, "every": 2}),
}  # fmt: skip


class PunishedEnd(gymnasium.Wrapper):
    """A reward of −10 where the pole falls, as many tutorials have it."""

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, -10.0 if terminated else reward, terminated, truncated, info


class Bounded(gymnasium.ObservationWrapper):
    """CartPole's velocities have no bounds of their own."""

    def __init__(self, env):
        super().__init__(env)
        high = np.array([4.8, 4, 0.42, 4], np.float32)
        self.observation_space = gymnasium.spaces.Box(-high, high)

    def observation(self, observation):
        return observation

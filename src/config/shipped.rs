//! The configs that come with the program: the files of `configs/`, each under its name without `.json`.

use super::ConfigError;

/// A config that comes with the program.
#[derive(Debug)]
pub struct Shipped {
    pub name: &'static str,
    /// What it is, in at most 56 characters.
    pub about: &'static str,
    /// The file.
    pub text: &'static str,
}

macro_rules! shipped {
    ($($name:literal: $about:literal;)*) => {
        &[$(Shipped {
            name: $name,
            about: $about,
            text: include_str!(concat!("../../configs/", $name, ".json")),
        }),*]
    };
}

/// All of them, the default first.
pub const SHIPPED: &[Shipped] = shipped! {
    "cartpole": "the default: 8-step DQN until a policy lasts";
    "fast": "Double DQN with a wider network, for 10,000 steps";
    "plain": "plain DQN with settings that hold";
    "tutorial": "a beginner's tutorial in Keras";
    "forgetting": "DQN as most programs have it, which learns and forgets";
    "q_table": "a table of 12 cells on CartPole";
    "q_table_fine": "a table of 10,000 cells on CartPole";
    "q_table_mountain_car": "a table of 400 cells on MountainCar";
    "acrobot": "Acrobot-v1";
    "mountain_car": "MountainCar-v0";
    "lunar_lander": "LunarLander-v3 of Gymnasium; needs a clone and Python";
    "ladder/01_tutorial": "the tutorial, for 20,000 steps; the others lead on";
    "ladder/02_minibatch": "one update for a whole minibatch, as in PyTorch";
    "ladder/03_truncation": "a time limit is no fall";
    "ladder/04_soft_target": "the target network moves a little every step";
    "ladder/05_target_policy": "the target network is the policy";
    "ladder/06_n_step": "eight rewards in a target";
    "ladder/07_gamma": "the discount factor is 0.999";
    "ladder/08_memory": "a memory that forgets nothing";
    "ladder/09_learning_rate": "three times the learning rate";
    "ladder/10_mirror": "mirror images";
    "ladder/11_exploration": "ε falls by steps, to 0.2";
    "ladder/12_reward_scale": "rewards of 0.01";
    "ladder/13_long_episodes": "training episodes of up to 10,000 steps";
    "ladder/14_early_end": "the default, which ends with a policy that lasts";
    "smoke": "a small, short run for tests";
};

/// Name and text of a config that comes with the program, as [`Config::from_layers`](super::Config::from_layers) takes them.
///
/// # Errors
/// When there is none of this name; the message has the most similar name.
pub fn shipped(name: &str) -> Result<(&'static str, &'static str), ConfigError> {
    let found = SHIPPED.iter().find(|shipped| shipped.name == name);
    found.map(|shipped| (shipped.name, shipped.text)).ok_or_else(|| {
        let all = || SHIPPED.iter().map(|shipped| shipped.name).collect::<Vec<_>>().join(", ");
        let hint = nearest_shipped(name)
            .map_or_else(|| format!("there are {}", all()), |name| format!("did you mean `{name}`?"));
        ConfigError::Name { name: super::layer::shown(name), hint }
    })
}

/// The name that a misspelled one is most like.
pub(crate) fn nearest_shipped(name: &str) -> Option<&'static str> {
    let name = name.to_lowercase();
    let likeness = |known: &'static str| (strsim::normalized_damerau_levenshtein(&name, known), known);
    let alike = SHIPPED.iter().map(|shipped| likeness(shipped.name)).filter(|(likeness, _)| *likeness > 0.65);
    alike.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, name)| name)
}

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
    "cartpole": "the default: Double DQN until a policy lasts";
    "fast": "the default with half of its steps and of its memory";
    "plain": "plain DQN, a time limit handled as truncation";
    "tutorial": "a beginner's tutorial in Keras";
    "forgetting": "DQN as most programs have it, which learns and forgets";
    "q_table": "a table of 12 cells on CartPole";
    "q_table_fine": "a table of 10,000 cells on CartPole";
    "q_table_mountain_car": "a table of 400 cells on MountainCar";
    "acrobot": "Acrobot-v1";
    "mountain_car": "MountainCar-v0";
    "lunar_lander": "LunarLander-v3 of Gymnasium; needs a clone and Python";
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
    let names = SHIPPED.iter().map(|shipped| likeness(shipped.name));
    names
        .filter(|(likeness, _)| *likeness > 0.65)
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, name)| name)
}

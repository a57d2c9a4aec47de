//! What other programs call the settings of this one, and what a word that is no key may mean.

use std::iter::once;

use serde_json::Value;

use super::keys::{KEYS, Key, whole};

/// Longest word that is compared with others.
const MAX_LENGTH: usize = 64;

/// Words of other programs, and the settings that each of them can mean, with `{}` in the place of the value. A word of several
/// meanings has one line for each in its list.
const ALIASES: &[(&str, &[&str])] = &[
    ("steps num_steps max_steps timesteps total_timesteps", &["budget.steps={}"]),
    ("episodes num_episodes n_episodes max_episodes", &["budget.episodes={}"]),
    ("lr alpha step_size", &["optimizer.learning_rate={}"]),
    ("discount discount_factor", &["gamma={}"]),
    ("batch minibatch_size", &["replay.batch_size={}"]),
    (
        "buffer buffer_size buffer_capacity memory memory_size replay_size replay_memory maxlen",
        &["replay.capacity={}"],
    ),
    ("warmup learning_starts min_replay_size", &["replay.warmup_steps={}"]),
    ("epsilon eps", &["exploration.initial={} exploration.final={}", "optimizer.epsilon={}"]),
    ("epsilon_start eps_start start_e epsilon_max exploration_initial_eps", &["exploration.initial={}"]),
    ("epsilon_end eps_end end_e epsilon_min eps_min exploration_final_eps", &["exploration.final={}"]),
    (
        "epsilon_decay eps_decay",
        &[
            "exploration.schedule=per_episode exploration.decay={}",
            "exploration.schedule=linear exploration.steps={}",
        ],
    ),
    ("exploration_steps epsilon_decay_steps", &["exploration.schedule=linear exploration.steps={}"]),
    ("tau", &["target.kind=soft target.tau={}"]),
    // Only the weights of a soft target network can be the policy.
    (
        "target_update target_update_freq target_update_interval target_network_frequency",
        &["policy_weights=online target.kind=hard target.every_steps={}"],
    ),
    ("double_dqn double_q ddqn", &["double=true"]),
    ("no_double", &["double=false"]),
    ("huber", &["loss=huber"]),
    ("hidden_size hidden_sizes hidden_units hidden_layers layers net_arch", &["network.hidden={}"]),
    ("n_steps multi_step", &["n_step={}"]),
    ("train_freq train_frequency update_every update_freq", &["learn.every_steps={}"]),
    ("gradient_steps", &["learn.updates={}"]),
    ("max_grad_norm grad_clip gradient_clip", &["optimizer.max_gradient_norm={}"]),
    ("eval_freq eval_every eval_interval", &["evaluation.every_steps={}"]),
    ("eval_episodes n_eval_episodes", &["evaluation.episodes={}"]),
    ("save_freq save_every checkpoint_every checkpoint_freq", &["checkpoint.every_steps={}"]),
    ("env env_id", &["environment={}"]),
];

/// What a word means here, whether it is an option of another program or the name of a key: a list of settings for each meaning,
/// with `{}` in the place of the value. `value` decides between meanings where only some allow it.
pub fn meanings(word: &str, value: &Value) -> Vec<Vec<String>> {
    let own = |key: &Key| vec![format!("{}={{}}", key.path)];
    if word.len() > MAX_LENGTH {
        return Vec::new();
    }
    let (path, word) = (word, normalised(word));
    if let Some(key) = KEYS.iter().find(|key| normalised(key.path) == word) {
        return vec![own(key)];
    }
    let mut found: Vec<Vec<String>> =
        match ALIASES.iter().find(|(words, _)| words.split(' ').any(|known| known == word)) {
            Some((_, meanings)) => {
                meanings.iter().map(|all| all.split(' ').map(String::from).collect()).collect()
            }
            None => KEYS.iter().filter(|key| last(key.path) == word).map(own).collect(),
        };
    if let (true, Some((group, name))) = (found.is_empty(), path.rsplit_once('.')) {
        // A word behind the name of a group means what it means alone, in that group if it means something there.
        found = meanings(name, value);
        keep_if_any(&mut found, |setting| {
            setting.strip_prefix(group).is_some_and(|rest| rest.starts_with('.'))
        });
    }
    let value = whole(value.clone());
    keep_if_any(&mut found, |setting| {
        let key = setting.strip_suffix("={}").and_then(|path| KEYS.iter().find(|key| key.path == path));
        key.is_none_or(|key| key.allowed.admits(&value))
    });
    found
}

/// Keeps the meanings all of whose settings are such, unless there are none.
fn keep_if_any(found: &mut Vec<Vec<String>>, is_such: impl Fn(&str) -> bool) {
    let is_kept = |meaning: &Vec<String>| meaning.iter().all(|setting| is_such(setting));
    if found.iter().any(is_kept) {
        found.retain(is_kept);
    }
}

/// What to say of a key that there is not.
pub(super) fn hint(key: &str, value: &Value) -> String {
    let found = match meanings(key, value) {
        found if found.is_empty() => nearest(key).map_or(found, |word| meanings(word, value)),
        found => found,
    };
    if !found.is_empty() {
        let quoted = |setting: &String| format!("`{}`", setting.trim_end_matches("={}"));
        let meaning = |meaning: &Vec<String>| meaning.iter().map(quoted).collect::<Vec<_>>().join(" and ");
        return format!("did you mean {}?", found.iter().map(meaning).collect::<Vec<_>>().join(", or "));
    }
    let siblings = key.split_once('.').map_or(String::new(), |(group, _)| keys_in(&format!("{group}.")));
    format!("allowed: {}", if siblings.is_empty() { keys_in("") } else { siblings })
}

/// The keys directly below a prefix (`"budget."`, or `""` for the top level), for messages. Empty if there are none.
pub(super) fn keys_in(prefix: &str) -> String {
    let below = KEYS.iter().filter_map(|key| key.path.strip_prefix(prefix)?.split('.').next());
    let mut keys: Vec<_> = below.map(|key| format!("`{key}`")).collect();
    keys.dedup();
    keys.join(", ")
}

/// The word that a misspelled key is most like.
fn nearest(key: &str) -> Option<&'static str> {
    let like = strsim::normalized_damerau_levenshtein;
    // The right name in the wrong group counts almost as much as the right path. The group alone counts nothing.
    let of_path = |path: &'static str| {
        let name = like(last(key), last(path));
        let whole = if name > 0.3 { like(key, path) } else { 0.0 };
        // What is said of the name alone is said of all keys that have it.
        if whole >= 0.9 * name { (whole, path) } else { (0.9 * name, last(path)) }
    };
    let words = ALIASES.iter().flat_map(|(words, _)| words.split(' '));
    let of_word = |word: &'static str| (0.9 * like(&normalised(last(key)), word), word);
    let known = KEYS.iter().map(|key| of_path(key.path)).chain(words.map(of_word));
    let best = known
        .filter(|_| key.len() <= MAX_LENGTH)
        .chain(once((0.6, "")))
        .max_by(|(a, _), (b, _)| a.total_cmp(b));
    best.map(|(_, word)| word).filter(|word| !word.is_empty())
}

fn last(path: &str) -> &str {
    path.rsplit('.').next().unwrap_or_default()
}

/// A word in the one spelling of [`ALIASES`].
fn normalised(word: &str) -> String {
    word.to_lowercase().replace(['.', '-'], "_")
}

//! What other programs call the settings of this one, and what a word that is no key may mean.

use serde_json::Value;

use super::keys::{KEYS, Key, find, whole};

/// Longest word that is compared with others.
const MAX_LENGTH: usize = 64;

/// Words of other programs, and the settings that each of them can mean, with `{}` in the place of the value.
const ALIASES: &[(&str, &[&str])] = &[
    ("steps", &["budget.steps={}"]),
    ("total_timesteps", &["budget.steps={}"]),
    ("episodes", &["budget.episodes={}"]),
    ("lr", &["optimizer.learning_rate={}"]),
    ("discount", &["gamma={}"]),
    ("buffer_size", &["replay.capacity={}"]),
    ("memory_size", &["replay.capacity={}"]),
    ("warmup", &["replay.warmup_steps={}"]),
    ("learning_starts", &["replay.warmup_steps={}"]),
    ("epsilon", &["exploration.initial={} exploration.final={}", "optimizer.epsilon={}"]),
    ("epsilon_start", &["exploration.initial={}"]),
    ("epsilon_end", &["exploration.final={}"]),
    ("epsilon_min", &["exploration.final={}"]),
    (
        "epsilon_decay",
        &[
            "exploration.schedule=per_episode exploration.decay={}",
            "exploration.schedule=linear exploration.steps={}",
        ],
    ),
    ("tau", &["target.kind=soft target.tau={}"]),
    // Only the weights of a soft target network can be the policy.
    ("target_update", &["policy_weights=online target.kind=hard target.every_steps={}"]),
    ("train_freq", &["learn.every_steps={}"]),
    ("gradient_steps", &["learn.updates={}"]),
    ("max_grad_norm", &["optimizer.max_gradient_norm={}"]),
    ("eval_freq", &["evaluation.every_steps={}"]),
    ("eval_episodes", &["evaluation.episodes={}"]),
    ("save_freq", &["checkpoint.every_steps={}"]),
    ("env", &["environment={}"]),
];

/// What a key or another program's option means here: settings for each meaning that admits `value`, with `{}` for it.
pub(crate) fn meanings(word: &str, value: &Value) -> Vec<Vec<String>> {
    let own = |key: &Key| vec![format!("{}={{}}", key.path)];
    let known = normalised(word);
    if let Some(key) = KEYS.iter().find(|key| normalised(key.path) == known) {
        return vec![own(key)];
    }
    let name = normalised(last(word));
    let mut found: Vec<Vec<String>> = match ALIASES.iter().find(|(alias, _)| *alias == name) {
        Some((_, all)) => all.iter().map(|one| one.split(' ').map(String::from).collect()).collect(),
        None => KEYS.iter().filter(|key| last(key.path) == name).map(own).collect(),
    };
    // A word behind the name of a group means what it means alone, in that group if it means something there.
    if let Some((group, _)) = word.rsplit_once('.') {
        keep_if_any(&mut found, |setting| setting.starts_with(&format!("{group}.")));
    }
    let value = whole(value.clone());
    keep_if_any(&mut found, |setting| {
        let key = setting.strip_suffix("={}").and_then(find);
        key.is_none_or(|key| key.allowed.admits(&value))
    });
    found
}

/// Keeps the meanings all of whose settings are such, unless there are none.
fn keep_if_any(found: &mut Vec<Vec<String>>, is_such: impl Fn(&String) -> bool) {
    if found.iter().any(|settings| settings.iter().all(&is_such)) {
        found.retain(|settings| settings.iter().all(&is_such));
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

/// The key or alias that a misspelled key is most like; where no group was typed, the name that some keys have in theirs.
fn nearest(key: &str) -> Option<&'static str> {
    let like = strsim::normalized_damerau_levenshtein;
    let likeness = |path: &'static str| match key.contains('.') {
        true => (f64::midpoint(like(key, path), like(last(key), last(path))), path),
        false => (like(key, last(path)), last(path)),
    };
    let words = ALIASES.iter().map(|(word, _)| (0.9 * like(&normalised(last(key)), word), *word));
    let known = KEYS.iter().map(|known| likeness(known.path)).chain(words);
    let alike = known.filter(|(likeness, _)| key.len() <= MAX_LENGTH && *likeness > 0.65);
    alike.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, word)| word)
}

fn last(path: &str) -> &str {
    path.rsplit('.').next().unwrap_or_default()
}

/// A word in the one spelling of [`ALIASES`].
fn normalised(word: &str) -> String {
    word.to_lowercase().replace(['.', '-'], "_")
}

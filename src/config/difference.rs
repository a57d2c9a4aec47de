//! What two configs, or two lists of them, differ in.

use serde_json::Value;

/// The first key by which two values differ, and how.
pub fn difference(path: &str, found: &Value, given: &Value) -> Option<String> {
    let below = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match (found, given) {
        (Value::Object(a), Value::Object(b)) => {
            let keys = a.keys().chain(b.keys().filter(|key| !a.contains_key(*key)));
            let absent = Value::Null;
            keys.into_iter().find_map(|key| {
                difference(&below(key), a.get(key).unwrap_or(&absent), b.get(key).unwrap_or(&absent))
            })
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            let mut pairs = a.iter().zip(b).enumerate();
            pairs.find_map(|(i, (a, b))| difference(&below(&i.to_string()), a, b))
        }
        (Value::Array(a), Value::Array(b)) if path == "configs" => {
            Some(format!("it has {} configs, and {} are given", a.len(), b.len()))
        }
        _ => (found != given).then(|| format!("its `{path}` is {found}, and {given} is given")),
    }
}

//! What two configs, or other JSON values that hold configs, differ in.

use serde_json::Value;

/// Says in which key two values differ first, and how. `path` is the key of the values themselves.
pub(crate) fn difference(path: &str, found: &Value, given: &Value) -> Option<String> {
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
        // Lists of objects can fill pages.
        (Value::Array(a), Value::Array(b)) if a.iter().chain(b).any(Value::is_object) => {
            Some(format!("it has {} {path}, and {} are given", a.len(), b.len()))
        }
        _ => (found != given).then(|| format!("its `{path}` is {found}, and {given} is given")),
    }
}

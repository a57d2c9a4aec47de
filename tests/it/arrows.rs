//! The direction of dependencies. A room may use the rooms that are listed for it and no others, and no file uses one that
//! uses it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Every room of the crate, from the ground floor up, and the rooms that it may use.
const ALLOWED: &[(&str, &[&str])] = &[
    ("os", &[]),
    ("rng", &[]),
    ("mirror", &[]),
    ("memory", &[]),
    ("text", &[]),
    ("files", &["os"]),
    ("nn", &["rng"]),
    ("env", &["os", "rng", "mirror", "text"]),
    ("tensors", &["rng", "nn"]),
    ("agent", &["rng", "mirror", "nn", "tensors"]),
    ("trainer", &["rng", "env", "tensors", "agent"]),
    ("config", &["memory", "text", "nn", "env", "agent", "trainer"]),
    ("check", &["nn", "env", "agent", "tensors", "text", "files"]),
    ("explain", &["nn", "env", "tensors", "agent", "trainer", "config", "check"]),
    ("sink", &["files", "trainer"]),
    ("run", &["memory", "text", "files", "nn", "env", "tensors", "agent", "trainer", "config", "sink"]),
    ("study", &["os", "text", "files", "env", "agent", "trainer", "config", "run"]),
    ("draw", &["env"]),
    ("view", &["text", "env", "agent", "trainer", "draw"]),
    ("report", &["rng", "text", "files", "env", "agent", "trainer", "config", "run", "study", "draw"]),
    (
        "cli",
        &[
            "os", "rng", "memory", "text", "files", "nn", "env", "tensors", "agent", "trainer", "config",
            "check", "explain", "sink", "run", "study", "draw", "view", "report",
        ],
    ),
    ("main", &["cli"]),
];

/// Name of the file's module (`nn::kernels::fast`) and its code, without comments and tests.
fn modules() -> BTreeMap<String, String> {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut modules = BTreeMap::new();
    let mut directories = vec![src.clone()];
    while let Some(directory) = directories.pop() {
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                directories.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let name = path.strip_prefix(&src).unwrap().with_extension("").display().to_string();
                let name = name.replace('/', "::");
                let name = name.strip_suffix("::mod").unwrap_or(&name).to_owned();
                let text = fs::read_to_string(&path).unwrap();
                let code = text.split("#[cfg(test)]").next().unwrap();
                let is_code = |line: &&str| !line.trim_start().starts_with("//");
                modules.insert(name, code.lines().filter(is_code).collect::<Vec<_>>().join("\n"));
            }
        }
    }
    modules.remove("lib");
    modules
}

/// The paths that a text names after `prefix`: each member of a group `{a, b::c}` is one.
fn paths_after(code: &str, prefix: &str) -> Vec<String> {
    let mut paths = Vec::new();
    for (start, _) in code.match_indices(prefix) {
        let is_part_of_a_name =
            code[..start].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':');
        if !is_part_of_a_name {
            expand("", &code[start + prefix.len()..], &mut paths);
        }
    }
    paths
}

/// Adds the paths that `text` begins with, and returns what follows them.
fn expand<'a>(before: &str, text: &'a str, paths: &mut Vec<String>) -> &'a str {
    let text = text.trim_start();
    if let Some(mut members) = text.strip_prefix('{') {
        loop {
            members = members.trim_start_matches(|c: char| c.is_whitespace() || c == ',');
            match members.strip_prefix('}') {
                Some(rest) => return rest,
                None if members.is_empty() => return members,
                None => {
                    let rest = expand(before, members, paths);
                    // `self as name`, `name as other`
                    members = rest.trim_start_matches(|c: char| c != ',' && c != '}');
                }
            }
        }
    }
    let end = text.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(text.len());
    let path = if before.is_empty() { text[..end].to_owned() } else { format!("{before}::{}", &text[..end]) };
    match text[end..].strip_prefix("::") {
        Some(rest) => expand(&path, rest, paths),
        None => {
            paths.push(path);
            &text[end..]
        }
    }
}

/// The module that a path leads to: the longest beginning of the path that is one.
fn module_of<'a>(path: &str, modules: &'a BTreeMap<String, String>) -> Option<&'a str> {
    let mut end = path.len();
    loop {
        if let Some((name, _)) = modules.get_key_value(&path[..end]) {
            return Some(name);
        }
        end = path[..end].rfind("::")?;
    }
}

/// The modules that each module uses, itself and the declarations of its own parts apart.
fn uses(modules: &BTreeMap<String, String>) -> BTreeMap<&str, BTreeSet<&str>> {
    let mut uses: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (name, code) in modules {
        let mut paths = paths_after(code, "crate::");
        let mut parent = name.as_str();
        let mut prefix = String::from("super::");
        while let Some((above, _)) = parent.rsplit_once("::") {
            // `super::` after `super::` is another prefix, and no name.
            let relative = paths_after(code, &prefix);
            paths.extend(
                relative
                    .into_iter()
                    .filter(|path| !path.starts_with("super"))
                    .map(|path| format!("{above}::{path}")),
            );
            prefix += "super::";
            parent = above;
        }
        let used = paths.iter().filter_map(|path| module_of(path, modules)).filter(|used| used != name);
        uses.entry(name).or_default().extend(used);
    }
    uses
}

#[test]
fn every_room_uses_only_the_rooms_that_it_may() {
    let modules = modules();
    let room = |module: &str| module.split("::").next().unwrap().to_owned();
    let rooms: BTreeSet<String> = modules.keys().map(|module| room(module)).collect();
    let listed: BTreeSet<String> = ALLOWED.iter().map(|(room, _)| (*room).to_owned()).collect();
    assert_eq!(rooms, listed, "every room is in the list");
    for (i, (name, allowed)) in ALLOWED.iter().enumerate() {
        let is_below = |other: &&str| ALLOWED[..i].iter().any(|(below, _)| below == other);
        assert!(allowed.iter().all(is_below), "{name} may use only what is listed above it");
    }
    for (module, used) in uses(&modules) {
        let (_, allowed) = ALLOWED.iter().find(|(name, _)| *name == room(module)).unwrap();
        for other in used.into_iter().map(room).filter(|other| *other != room(module)) {
            assert!(allowed.contains(&other.as_str()), "{module} uses {other}");
        }
    }
}

#[test]
fn no_two_files_use_each_other() {
    let modules = modules();
    let uses = uses(&modules);
    // A parent's `mod.rs` shows its parts to others: what it re-exports is no use.
    let is_parent = |a: &str, b: &str| b.strip_prefix(a).is_some_and(|rest| rest.starts_with("::"));
    let mut circles = Vec::new();
    for start in uses.keys() {
        let (mut seen, mut open) = (BTreeSet::new(), vec![*start]);
        while let Some(module) = open.pop() {
            for &next in uses.get(module).into_iter().flatten() {
                if next == *start {
                    circles.push(*start);
                } else if !is_parent(module, next) && !is_parent(next, module) && seen.insert(next) {
                    open.push(next);
                }
            }
        }
    }
    circles.dedup();
    assert!(circles.is_empty(), "in circles: {circles:?}");
}

#[test]
fn no_command_uses_a_command() {
    const COMMANDS: [&str; 14] = [
        "check",
        "completions",
        "config",
        "eval",
        "explain",
        "inspect",
        "render",
        "report",
        "runs",
        "study",
        "train",
        "verify",
        "watch",
        "web",
    ];
    let modules = modules();
    for (module, used) in uses(&modules) {
        let command = |module: &str| {
            module.strip_prefix("cli::").filter(|name| COMMANDS.contains(name)).map(String::from)
        };
        if command(module).is_some() {
            let commands: Vec<_> = used.into_iter().filter_map(command).collect();
            assert!(commands.is_empty(), "{module} uses {commands:?}");
        }
    }
}

#[test]
fn only_the_command_line_sinks_and_views_print() {
    for (module, code) in modules() {
        let prints = ["println!", "eprintln!", "print!(", "io::stdout()", "io::stderr()"];
        let may_print = ["cli", "sink", "view"].iter().any(|room| module.starts_with(room));
        assert!(may_print || !prints.iter().any(|print| code.contains(print)), "{module} prints");
    }
}

/// What is in no other room does not change a disk. What is written by an open file has been opened there.
#[test]
fn no_room_but_files_and_os_opens_for_writing_or_changes_a_directory() {
    const CHANGES: [&str; 16] = [
        "File::create",
        "File::options",
        "OpenOptions",
        "fs::write",
        "fs::copy",
        "fs::rename",
        "fs::hard_link",
        "fs::soft_link",
        "fs::symlink",
        "fs::create_dir",
        "fs::remove_",
        "fs::set_permissions",
        "DirBuilder",
        "tempfile::",
        "rustix::fs",
        "create_new(",
    ];
    for (module, code) in modules() {
        let found = CHANGES.iter().find(|change| code.contains(**change));
        assert!(
            module.starts_with("files") || module.starts_with("os::") || found.is_none(),
            "{module} has {found:?}"
        );
    }
}

#[test]
fn no_room_but_os_asks_which_system_it_is() {
    const SYSTEMS: [&str; 4] = ["unix", "windows", "target_os", "target_family"];
    const PARTS: [&str; 4] = ["std::os::", "rustix::", "signal_hook::", "ctrlc::"];
    for (module, code) in modules() {
        let asks = |line: &&str| {
            PARTS.iter().any(|part| line.contains(part))
                || (line.contains("cfg") && SYSTEMS.iter().any(|system| line.contains(system)))
        };
        let found = code.lines().find(asks);
        assert!(module.split("::").next() == Some("os") || found.is_none(), "{module} has {found:?}");
    }
}

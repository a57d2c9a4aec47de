//! What the documents refer to: files, headings, and keys of the config.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::AtomicBool;

use cartpole_dqn::config::Config;
use cartpole_dqn::env::catalogue::EnvironmentId;
use cartpole_dqn::run::FORMAT_VERSION;
use cartpole_dqn::trainer::{Event, SCORE_SEED, Score, evaluate};
use serde_json::Value;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The README and the like, and every page below `docs`.
fn pages() -> BTreeMap<PathBuf, String> {
    let mut directories = vec![root().join("docs")];
    let mut files: Vec<PathBuf> = fs::read_dir(root()).unwrap().map(|entry| entry.unwrap().path()).collect();
    while let Some(directory) = directories.pop() {
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { directories.push(path) } else { files.push(path) }
        }
    }
    files.retain(|path| path.extension().is_some_and(|extension| extension == "md"));
    files.into_iter().map(|path| (path.clone(), fs::read_to_string(&path).unwrap())).collect()
}

/// The lines that are not in a block of code.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut is_code = false;
    text.lines().filter(move |line| {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        !is_code && !is_fence
    })
}

/// The names by which GitHub links to the headings of a page.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut anchors = BTreeSet::new();
    for heading in prose(text).filter(|line| line.starts_with('#')) {
        let name: String = heading
            .trim_start_matches('#')
            .trim()
            .to_lowercase()
            .chars()
            .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'))
            .map(|c| if c == ' ' { '-' } else { c })
            .collect();
        let numbered = (1..).map(|number| format!("{name}-{number}"));
        let free = std::iter::once(name.clone()).chain(numbered).find(|name| !anchors.contains(name));
        anchors.insert(free.unwrap());
    }
    anchors
}

/// The targets of the links and pictures in a page.
fn targets(text: &str) -> Vec<&str> {
    prose(text)
        .flat_map(|line| line.split("](").skip(1))
        .filter_map(|rest| rest.split_once(')'))
        .map(|(target, _)| target)
        .collect()
}

/// `docs/../README.md` as `README.md`.
fn without_parents(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => assert!(plain.pop(), "{} leaves the repository", path.display()),
            part => plain.push(part),
        }
    }
    plain
}

/// What the packaged crate leaves out, where this is the packaged crate: `exclude` in `Cargo.toml`.
fn left_out() -> Vec<PathBuf> {
    let is_packaged = root().join("Cargo.toml.orig").exists();
    let manifest = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let (_, list) = manifest.split_once("\nexclude = [").unwrap();
    let (list, _) = list.split_once(']').unwrap();
    let names = list.split('"').skip(1).step_by(2).map(|name| root().join(name.trim_matches(['/', '*'])));
    names.chain([root().join("fuzz"), root().join("web")]).filter(|_| is_packaged).collect()
}

/// What is wrong with a link of the page `path`.
fn problem(pages: &BTreeMap<PathBuf, String>, path: &Path, target: &str) -> Option<String> {
    if target.starts_with("http://") || target.starts_with("https://") {
        return None;
    }
    let (file, anchor) = target.split_once('#').map_or((target, None), |(file, anchor)| (file, Some(anchor)));
    let found =
        if file.is_empty() { path.to_owned() } else { without_parents(&path.parent().unwrap().join(file)) };
    if !found.exists() {
        let is_left_out = left_out().iter().any(|directory| found.starts_with(directory));
        return (!is_left_out).then(|| format!("there is no {}", found.display()));
    }
    let anchor = anchor?;
    let headings = pages.get(&found).map(|text| anchors(text)).unwrap_or_default();
    (!headings.contains(anchor)).then(|| format!("{} has no heading #{anchor}", found.display()))
}

#[test]
fn every_link_of_a_document_leads_to_a_file_and_a_heading() {
    let pages = pages();
    let mut problems = Vec::new();
    for (path, text) in &pages {
        for target in targets(text) {
            problems.extend(
                problem(&pages, path, target).map(|problem| format!("{}: {problem}", path.display())),
            );
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn a_dead_link_is_found() {
    let pages = pages();
    let problem = |target| problem(&pages, &root().join("docs/dqn.md"), target);
    assert!(problem("no_such_page.md").unwrap().contains("there is no"));
    assert!(problem("../README.md#no-such-heading").unwrap().contains("has no heading #no-such-heading"));
    assert!(problem("#no-such-heading").is_some());
    assert_eq!(problem("../README.md#words"), None);
    assert_eq!(targets("[a](b.md) and ![c](d.svg)\n```\n[e](f)\n```\n"), ["b.md", "d.svg"]);
    let headings = anchors("# `update`\n## A, b: the c\n## A, b: the c\n```sh\n# no heading\n```\n");
    assert_eq!(headings.into_iter().collect::<Vec<_>>(), ["a-b-the-c", "a-b-the-c-1", "update"]);
}

/// What stands between backticks.
fn codes(cell: &str) -> impl Iterator<Item = &str> {
    cell.split('`').skip(1).step_by(2)
}

#[test]
fn the_page_for_keras_has_keys_that_exist_and_the_values_of_the_tutorial() {
    let file = ("tutorial.json", include_str!("../../configs/tutorial.json"));
    let tutorial = Config::from_layers(Some(file), &[]).unwrap();
    let values: BTreeMap<&str, Value> =
        tutorial.settings().into_iter().map(|setting| (setting.path, setting.value)).collect();
    let page = include_str!("../../docs/from_keras.md");
    let (_, table) =
        page.split_once("| a line of the tutorial | key | value |\n| --- | --- | --- |\n").unwrap();
    let mut named = BTreeSet::new();
    for row in table.lines().take_while(|line| line.starts_with('|')) {
        let cells: Vec<&str> = row.split(" | ").collect();
        let [_, keys, told] = cells[..] else { panic!("the row has not three cells: {row}") };
        assert_eq!(codes(keys).count(), codes(told).count(), "{row}");
        for (key, value) in codes(keys).zip(codes(told)) {
            let value: Value = serde_json::from_str(value).unwrap();
            assert_eq!(values.get(key), Some(&value), "{row}");
            named.insert(key);
        }
    }
    let own: Value = serde_json::from_str(file.1).unwrap();
    for group in own
        .as_object()
        .unwrap()
        .keys()
        .filter(|key| !matches!(key.as_str(), "$schema" | "evaluation" | "checkpoint"))
    {
        assert!(
            named.iter().any(|key| key.split('.').next() == Some(group)),
            "no row of the table is about {group}"
        );
    }
}

#[test]
fn the_page_about_checkpoints_names_their_version_and_everything_in_them() {
    let page = include_str!("../../docs/checkpoint.md");
    assert!(page.contains(&format!("format version {FORMAT_VERSION}.")));
    assert!(page.contains(&format!("| `format_version` | both | {FORMAT_VERSION} |")));
    let last = include_bytes!("../data/checkpoints/version3-last.safetensors");
    let length = u64::from_le_bytes(last[..8].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&last[8..8 + length]).unwrap();
    let metadata = header["__metadata__"]["cartpole-dqn"].as_str().unwrap();
    let metadata: Value = serde_json::from_str(metadata).unwrap();
    assert_eq!(metadata["format_version"], FORMAT_VERSION, "give this test a checkpoint of the new version");
    let names = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    let tensors = names(&header).into_iter().filter(|name| name != "__metadata__");
    let tensors = tensors.map(|name| {
        let layers: Vec<&str> =
            name.split('.').map(|part| if part.parse::<u32>().is_ok() { "{i}" } else { part }).collect();
        layers.join(".")
    });
    for name in tensors.chain(names(&metadata)).chain(names(&metadata["progress"])) {
        assert!(page.contains(&format!("`{name}`")), "docs/checkpoint.md does not name `{name}`");
    }
}

#[test]
fn the_library_example_of_the_readme_prints_what_the_readme_says() {
    let readme = include_str!("../../README.md");
    let sets = ["seed=3".to_owned(), "budget.steps=2000".to_owned()];
    assert!(readme.contains(r#"Config::from_layers(None, &["seed=3".into(), "budget.steps=2000".into()])"#));
    let mut trainer = Config::from_layers(None, &sets).unwrap().make_trainer().unwrap();
    let mut events: Vec<Event> = Vec::new();
    trainer.run(&mut events, &AtomicBool::new(false)).unwrap();
    let make = |max_steps| EnvironmentId::CartPoleV1.make(max_steps);
    let played = evaluate(&trainer.agent().policy(), &make, 500, SCORE_SEED, 100, 1.0).unwrap();
    let returns: Vec<f64> = played.iter().map(|episode| episode.total).collect();
    let printed = format!("`{} events, mean return {:.1}`", events.len(), Score::new(&returns).mean);
    assert!(readme.contains(&printed), "{printed}");
}

//! The config: what is refused and how, how layers merge, and that nothing is lost on the way to a file and back.

use std::fs;
use std::path::{Path, PathBuf};

use cartpole_dqn::agent::{Exploration, Period, TargetUpdate};
use cartpole_dqn::config::{self, Config, ConfigError};
use cartpole_dqn::trainer::Budget;
use serde_json::{Value, json};

fn layered(file: &str, sets: &[&str]) -> Result<Config, ConfigError> {
    let sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
    Config::from_layers(Some(("run.json", file)), &sets)
}

fn merged(file: &str, sets: &[&str]) -> Config {
    layered(file, sets).unwrap()
}

/// The error of a file and sets must hold every fragment.
#[track_caller]
fn refused(file: &str, sets: &[&str], fragments: &[&str]) {
    let message = layered(file, sets).expect_err(&format!("{file} {sets:?} must be refused")).to_string();
    for fragment in fragments {
        assert!(message.contains(fragment), "{file} {sets:?}\n  says    {message}\n  without {fragment}");
    }
}

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("configs").join(name).with_extension("json")
}

fn shipped_configs() -> Vec<PathBuf> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
    let paths = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
    paths.filter(|path| path.extension().is_some_and(|extension| extension == "json")).collect()
}

/// Runs, studies and checkpoints of earlier versions hold `network.symmetric`.
#[test]
fn a_recorded_config_with_a_key_that_is_gone_is_read_if_the_key_changed_nothing() {
    let recorded = r#"{"network": {"hidden": [8, 6], "init": "torch", "symmetric": false}}"#;
    let config = merged(recorded, &[]);
    assert_eq!(config, merged(r#"{"network": {"hidden": [8, 6]}}"#, &[]));
    let mut whole = serde_json::to_value(&config).unwrap();
    whole["network"]["symmetric"] = json!(false);
    assert_eq!(serde_json::from_value::<Config>(whole).unwrap(), config);
    assert_eq!(merged("{}", &["network.symmetric=false"]), Config::default());

    let hint = ["removed key `network.symmetric`", "`replay.mirror` to true"];
    refused(r#"{"network": {"symmetric": true}}"#, &[], &hint);
    refused("{}", &["network.symmetric=true"], &hint);
    refused(r#"{"network.symmetric": 1}"#, &[], &hint);
}

#[test]
fn the_default_is_the_file_cartpole_json() {
    let file = fs::read_to_string(shipped("cartpole")).unwrap();
    assert_eq!(merged(&file, &[]), Config::default());
    assert_eq!(Config::from_layers(None, &[]).unwrap(), Config::default());
    assert_eq!(
        merged(r#"{"budget": {}, "target": {}, "exploration": {}, "network": {}}"#, &[]),
        Config::default()
    );
}

/// Every other agent and task starts from the same default, without what it cannot have.
#[test]
fn another_task_or_agent_has_the_default_for_every_key_that_it_has() {
    let default = json!(Config::default());
    let differing = |sets: &[&str]| {
        let config = json!(merged("{}", sets));
        let mut keys: Vec<String> = Vec::new();
        for (key, value) in config.as_object().unwrap() {
            if default.get(key).is_none_or(|default| default != value) {
                keys.push(key.clone());
            }
        }
        keys
    };
    let acrobot = ["environment", "stop_when_lasting_steps"];
    assert_eq!(differing(&["environment=Acrobot-v1"]), acrobot);
    let mountain_car = ["environment", "replay", "stop_when_lasting_steps"];
    assert_eq!(differing(&["environment=MountainCar-v0"]), mountain_car);
    assert_eq!(differing(&[r#"environment={"command":["./task"]}"#]), mountain_car);
    assert_eq!(differing(&["agent=q_table"]), ["agent", "table", "optimizer"]);
}

#[test]
fn a_config_survives_its_file() {
    let far_from_default = [
        &[
            "seed=18446744073709551615",
            "budget.episodes=7",
            "policy_weights=online",
            "target.kind=hard",
            "target.every_episodes=3",
        ][..],
        &[
            "exploration.schedule=per_episode",
            "target.kind=none",
            "policy_weights=online",
            "network.hidden=[]",
            "gamma=0.1234567890123456789",
        ],
        &[
            "stop_when_solved=true",
            "optimizer.epsilon=1e-7",
            "replay.update=per_sample",
            "network.init=he_uniform",
        ],
        &[
            "n_step=5",
            "double=true",
            "target.kind=soft",
            "target.tau=0.01",
            "policy_weights=target",
            "optimizer.max_gradient_norm=10",
            "optimizer.schedule.final_learning_rate=1e-5",
            "observation_divisors=[2.4,2,0.2095,2]",
            "reward_scale=0.01",
        ],
    ];
    for sets in far_from_default {
        let config = merged("{}", sets);
        let file = serde_json::to_string_pretty(&config).unwrap();
        assert_eq!(merged(&file, &[]), config, "{file}");
    }
}

#[test]
fn every_shipped_config_is_valid() {
    let paths = shipped_configs();
    assert!(!paths.is_empty());
    for path in paths {
        let text = config::read_file(&path).unwrap();
        Config::from_layers(Some((&path.to_string_lossy(), &text)), &[]).unwrap();
    }
}

#[test]
fn every_key_of_a_resolved_config_can_be_set() {
    let everything = [
        "{}",
        r#"{"exploration": {"schedule": "per_episode"}, "budget": {"episodes": 2}}"#,
        r#"{"target": {"kind": "soft"}, "optimizer": {"schedule": {"steps": 7}}, "observation_divisors": [1,2,3,4]}"#,
    ];
    for file in everything {
        let config = merged(file, &[]);
        for (key, value) in serde_json::to_value(&config).unwrap().as_object().unwrap() {
            assert_eq!(merged(file, &[&format!("{key}={value}")]), config);
            for (member, value) in value.as_object().into_iter().flatten() {
                assert_eq!(merged(file, &[&format!("{key}.{member}={value}")]), config, "{key}.{member}");
            }
        }
    }
}

#[test]
fn a_later_layer_wins() {
    let file =
        r#"{"$schema": "https://example.org/config.json", "gamma": 0.9, "replay": {"batch_size": 16}}"#;
    let config = merged(file, &["gamma=0.8", "gamma=0.7", "network.hidden=[8,4]", "environment=CartPole-v1"]);
    assert_eq!(config.agent.as_dqn().unwrap().gamma, 0.7);
    assert_eq!(config.agent.as_dqn().unwrap().replay.batch_size, 16);
    assert_eq!(config.agent.as_dqn().unwrap().replay.capacity, 20_000);
    assert_eq!(config.agent.as_dqn().unwrap().network.hidden, [8, 4]);
    assert_eq!(merged(file, &[r#"replay={"batch_size":8}"#]).agent.as_dqn().unwrap().replay.batch_size, 8);
    assert_eq!(merged("\u{feff}{\"seed\": 3}", &[]).seed, 3);
}

#[test]
fn a_whole_number_may_be_written_as_a_float() {
    let config =
        merged(r#"{"budget": {"steps": 3e4}, "network": {"hidden": [16.0]}, "gamma": 1}"#, &["seed=5.0"]);
    assert_eq!(
        (config.budget, config.seed, config.agent.as_dqn().unwrap().gamma),
        (Budget::Steps(30_000), 5, 1.0)
    );
    assert_eq!(config.agent.as_dqn().unwrap().network.hidden, [16]);
}

#[test]
fn one_alternative_replaces_the_other() {
    let per_episodes = r#"{"budget": {"episodes": 5}, "target": {"kind": "hard", "every_episodes": 10}, "policy_weights": "online"}"#;
    assert_eq!(merged(per_episodes, &[]).budget, Budget::Episodes(5));
    assert_eq!(merged(per_episodes, &["budget.steps=2000"]).budget, Budget::Steps(2000));
    assert_eq!(
        merged(r#"{"budget": {"steps": 2000}}"#, &["budget.episodes=10"]).budget,
        Budget::Episodes(10)
    );

    let target = |file, sets: &[&str]| merged(file, sets).agent.as_dqn().unwrap().target;
    assert_eq!(target(per_episodes, &[]), TargetUpdate::Hard(Period::EveryEpisodes(10)));
    assert_eq!(target(per_episodes, &["target.kind=hard"]), TargetUpdate::Hard(Period::EveryEpisodes(10)));
    assert_eq!(
        target(per_episodes, &["target.every_steps=500"]),
        TargetUpdate::Hard(Period::EverySteps(500))
    );
    assert_eq!(target(per_episodes, &["target.kind=none"]), TargetUpdate::None);
    let none = r#"{"target": {"kind": "none"}, "policy_weights": "online"}"#;
    assert_eq!(target(none, &["target.kind=hard"]), TargetUpdate::Hard(Period::EverySteps(500)));
    assert_eq!(
        target(none, &["target.every_episodes=2", "target.kind=hard"]),
        TargetUpdate::Hard(Period::EveryEpisodes(2))
    );
}

#[test]
fn a_changed_schedule_keeps_what_the_two_share() {
    let exploration = |file, sets: &[&str]| merged(file, sets).agent.exploration();
    let linear = r#"{"exploration": {"schedule": "linear", "initial": 0.9, "steps": 77}}"#;
    assert_eq!(
        exploration(linear, &["exploration.schedule=per_episode"]),
        Exploration::PerEpisode { initial: 0.9, final_: 0.01, decay: 0.995, repeat: 1 }
    );
    assert_eq!(
        exploration("{}", &["exploration.decay=0.5", "exploration.schedule=per_episode"]),
        Exploration::PerEpisode { initial: 1.0, final_: 0.01, decay: 0.5, repeat: 1 }
    );
    assert_eq!(
        exploration(linear, &["exploration.final=0.2"]),
        Exploration::Linear { initial: 0.9, final_: 0.2, steps: 77, repeat: 1 }
    );
    let per_episode = r#"{"exploration": {"schedule": "per_episode", "final": 0.3, "decay": 0.5}}"#;
    assert_eq!(
        exploration(per_episode, &["exploration.schedule=linear"]),
        Exploration::Linear { initial: 1.0, final_: 0.3, steps: 1500, repeat: 1 }
    );
}

#[test]
fn the_schedule_of_the_learning_rate_can_be_null() {
    let schedule = |file, sets: &[&str]| {
        let schedule = merged(file, sets).agent.learning_rate().schedule;
        schedule.map(|schedule| (schedule.final_learning_rate, schedule.steps))
    };
    let file = r#"{"optimizer": {"schedule": {"final_learning_rate": 1e-4, "steps": 77}}}"#;
    assert_eq!(schedule("{}", &[]), None);
    assert_eq!(schedule(file, &[]), Some((1e-4, 77)));
    assert_eq!(schedule(file, &["optimizer.schedule=null"]), None);
    assert_eq!(schedule(file, &["optimizer.schedule.steps=5"]), Some((1e-4, 5)));
    assert_eq!(schedule("{}", &["optimizer.schedule.steps=5"]), Some((0.0, 5)));
    assert_eq!(schedule("{}", &["optimizer.schedule.final_learning_rate=0.5"]), Some((0.5, 50_000)));
    assert_eq!(
        schedule(r#"{"optimizer": {"schedule": null}}"#, &["optimizer.schedule.steps=5"]),
        Some((0.0, 5))
    );
    let both = ["optimizer.schedule=null", "optimizer.schedule.steps=5"];
    refused("{}", &both, &["--set", "`optimizer.schedule.steps`", "null here"]);
    refused("{}", &["optimizer.schedule.step=5"], &["did you mean `optimizer.schedule.steps`?"]);
}

#[test]
fn a_key_of_another_alternative_is_refused() {
    refused(
        r#"{"budget": {"steps": 2000, "episodes": 2}}"#,
        &[],
        &["run.json", "`budget.episodes`", "\"steps\""],
    );
    refused(
        r#"{"budget": {"episodes": 2}}"#,
        &["budget.steps=2000", "budget.episodes=3"],
        &["--set", "`budget.steps`"],
    );
    refused(
        r#"{"exploration": {"schedule": "per_episode", "steps": 5}}"#,
        &["exploration.schedule=linear"],
        &[
            "run.json",
            "`exploration.steps`",
            r#"{"schedule": "per_episode", "initial", "final", "decay", "repeat"}"#,
        ],
    );
    refused("{}", &["exploration.decay=0.5"], &["--set", "`exploration.decay`", "linear"]);
    refused(
        "{}",
        &["target.kind=hard", "target.tau=0.5"],
        &["--set", "`target.tau`", r#"{"kind": "hard", "every_steps"}"#],
    );
    refused(r#"{"target": {"kind": "none", "every_steps": 5}}"#, &[], &["`target.every_steps`", "none"]);
    refused(r#"{"target": {"kind": "none"}}"#, &["target.every_steps=5"], &["--set", "`target.every_steps`"]);
    refused(
        "{}",
        &["target.kind=hard", "target.every_steps=5", "target.every_episodes=5"],
        &["`target.every_episodes`", "every_steps"],
    );
}

#[test]
fn what_is_not_json_is_refused_with_its_place() {
    refused("{\n  \"gamma\": 0.9,\n}", &[], &["run.json", "line 3 column 1"]);
    refused("", &[], &["run.json", "line 1"]);
    refused(r#"{"gamma": 1e999}"#, &[], &["run.json", "number out of range", "line 1"]);
    refused("[1]", &[], &["run.json", "expected an object"]);
    refused("null", &[], &["run.json", "expected an object"]);
    refused(&"[".repeat(100_000), &[], &["run.json"]);
    refused(&format!("{}1", r#"{"a":"#.repeat(100_000)), &[], &["run.json", "recursion limit"]);
}

#[test]
fn keys_that_are_unknown_or_come_twice_are_refused() {
    refused(r#"{"gama": 0.9}"#, &[], &["run.json", "unknown key `gama`", "did you mean `gamma`?"]);
    refused("{}", &["learning_rate=0.1"], &["--set", "did you mean `optimizer.learning_rate`?"]);
    refused("{}", &["optimiser.beta1=0.1"], &["did you mean `optimizer.beta1`?"]);
    refused(
        r#"{"zzz": 1}"#,
        &[],
        &[
            "unknown key `zzz`",
            "`seed`, `environment`, `max_episode_steps`, `agent`, `network`",
            "`stop_when_solved`",
        ],
    );
    refused(
        r#"{"replay": {"zzz": 1}}"#,
        &[],
        &["`replay.zzz`", "`capacity`, `batch_size`, `warmup_steps`, `update`"],
    );
    refused(r#"{"gamma.x": 1}"#, &[], &["unknown key `gamma.x`"]);
    refused("{}", &["=1"], &["--set", "unknown key ``"]);
    refused("{}", &["gamma"], &["--set gamma", "key.path=value"]);
    refused(&format!(r#"{{"{}": 1}}"#, "k".repeat(500_000)), &[], &["unknown key", "allowed"]);

    refused(r#"{"gamma": 0.9, "seed": 1, "gamma": 0.8}"#, &[], &["run.json", "duplicate key `gamma`"]);
    refused(r#"{"replay": {"capacity": 99, "capacity": 98}}"#, &[], &["duplicate key `replay.capacity`"]);
    refused(r#"{"replay": {"capacity": 99}, "replay": {"batch_size": 9}}"#, &[], &["duplicate key `replay`"]);
    refused(
        r#"{"replay": {"capacity": 99}, "replay.capacity": 98}"#,
        &[],
        &["duplicate key `replay.capacity`"],
    );
    refused("{}", &[r#"budget={"steps":2000,"steps":3000}"#], &["--set", "duplicate key `budget.steps`"]);
}

#[test]
fn a_value_of_a_wrong_type_or_out_of_range_is_refused() {
    let table = [
        ("seed=-1", "an integer from 0 to 2^64 - 1"),
        ("seed=1.5", "an integer"),
        ("environment=CartPole-v0", "\"CartPole-v1\""),
        ("environment=LunarLander-v3", "adapters/gymnasium.py"),
        ("environment=LunarLander-v3", "configs/lunar_lander.json"),
        ("network=24", "an object with `hidden`, `init`"),
        ("network.hidden=24", "a list of at most 16 integers"),
        ("network.hidden=[24,0]", "each from 1 to 4096"),
        ("network.hidden=[4097]", "each from 1 to 4096"),
        ("network.hidden=[1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1]", "at most 16"),
        ("network.init=zeros", "\"glorot_uniform\" or \"he_uniform\" or \"torch\""),
        ("optimizer.learning_rate=-0.001", "above 0"),
        ("optimizer.learning_rate=0", "above 0"),
        ("optimizer.learning_rate=fast", "a number"),
        ("optimizer.beta1=1", "below 1"),
        ("optimizer.beta2=-0.1", "from 0"),
        ("optimizer.epsilon=0", "a number from 1e-30"),
        ("loss=l1", "\"mse\" or \"huber\""),
        ("gamma=1.01", "from 0 to 1"),
        ("gamma=1e999", "from 0 to 1"),
        ("gamma=NaN", "from 0 to 1"),
        ("gamma=null", "from 0 to 1"),
        ("gamma={}", "from 0 to 1"),
        ("gamma=", "from 0 to 1"),
        ("replay.capacity=0", "from 1 to 100000000"),
        ("replay.capacity=100000001", "from 1 to 100000000"),
        ("replay.batch_size=0", "from 1 to 65536"),
        ("replay.batch_size=65537", "from 1 to 65536"),
        ("replay.batch_size=1.5", "an integer"),
        ("replay.update=all", "\"minibatch\" or \"per_sample\""),
        ("learn.every_steps=0", "from 1"),
        ("learn.updates=0", "from 1 to 4294967295"),
        ("exploration=linear", "an object with `schedule`"),
        ("exploration.schedule=cosine", "\"per_episode\" or \"linear\""),
        ("exploration.initial=1.1", "from 0 to 1"),
        ("exploration.final=-0.1", "from 0 to 1"),
        ("exploration.steps=0", "from 1"),
        ("exploration.decay=0", "above 0 and at most 1"),
        ("target=none", "an object with `kind`"),
        ("target.kind=polyak", "\"hard\" or \"none\""),
        ("target.every_steps=0", "from 1"),
        ("target.every_episodes=0", "from 1"),
        ("target.tau=0", "above 0 and at most 1"),
        ("target.tau=1.5", "above 0 and at most 1"),
        ("n_step=0", "an integer from 1 to 100"),
        ("n_step=101", "an integer from 1 to 100"),
        ("double=1", "true or false"),
        ("optimizer.max_gradient_norm=0", "null or a number from 1e-30 to 1e30"),
        ("optimizer.schedule=linear", "null or an object with `final_learning_rate`, `steps`"),
        ("optimizer.schedule.steps=0", "from 1"),
        ("optimizer.schedule.final_learning_rate=-0.1", "from 0 to 1"),
        (
            "observation_divisors=2",
            "null or a list with a number from 1e-30 to 1e30 for each observation coordinate",
        ),
        ("observation_divisors=[1,1,1,0]", "null or a list with a number from 1e-30 to 1e30"),
        ("observation_divisors=[1.5,1.5,1.5]", "for each of the 4 observation coordinates"),
        ("reward_scale=0", "a number from 1e-30"),
        ("reward_scale=null", "a number from 1e-30"),
        ("policy_weights=mean", "\"online\" or \"target\""),
        ("truncation_is_terminal=1", "true or false"),
        ("budget=5", "an object with `steps`, `episodes`"),
        ("budget.steps=0", "from 1"),
        ("budget.episodes=0", "from 1"),
        ("evaluation.every_steps=0", "from 1"),
        ("evaluation.episodes=0", "from 1 to 100000"),
        ("evaluation.episodes=100001", "from 1 to 100000"),
        ("checkpoint.every_steps=0", "from 1"),
        ("stop_when_solved=yes", "true or false"),
        ("$schema=1", "a string"),
    ];
    for (set, allowed) in table {
        let (key, value) = set.split_once('=').unwrap();
        refused("{}", &[set], &["--set: ", &format!("`{key}` is "), value, "allowed: ", allowed]);
    }
    refused(r#"{"gamma": "high"}"#, &[], &["run.json: ", "`gamma` is \"high\"", "a number from 0 to 1"]);
    refused(r#"{"seed": 18446744073709551616}"#, &[], &["`seed` is 1.8", "2^64 - 1"]);
    refused(r#"{"gamma": "\u001b[31m\u009b"}"#, &[], &["\\u001b[31m\\u{9b}"]);
}

#[test]
fn values_that_do_not_go_together_are_refused() {
    let table: [(&str, &[&str], &[&str]); 9] = [
        (
            "{}",
            &["target.kind=hard"],
            &["`policy_weights` is \"target\"", "only if `target.kind` is \"soft\""],
        ),
        (
            r#"{"target": {"kind": "soft"}, "policy_weights": "target"}"#,
            &["target.kind=none"],
            &["run.json with --set: ", "`policy_weights`", r#"`target` is {"kind":"none"}"#],
        ),
        (
            "{}",
            &["replay.capacity=16"],
            &["`replay.batch_size` is 32", "at most `replay.capacity`, which is 16"],
        ),
        (
            "{}",
            &["exploration.initial=0.01"],
            &["`exploration.final` is 0.2", "at most `exploration.initial`"],
        ),
        (
            "{}",
            &["budget.steps=500"],
            &["`budget.steps` is 500", "at least 501", "`replay.warmup_steps` is 500"],
        ),
        (
            "{}",
            &["budget.steps=31", "replay.warmup_steps=0"],
            &["`budget.steps` is 31", "`replay.batch_size` 32"],
        ),
        (
            "{}",
            &["budget.steps=2000", "learn.every_steps=2001"],
            &["at least 2001", "`learn.every_steps` 2001"],
        ),
        ("{}", &["replay.warmup_steps=18446744073709551615"], &["`budget.steps` is 40000"]),
        (r#"{"gamma": 0.5}"#, &["budget.steps=5"], &["run.json with --set: "]),
    ];
    for (file, sets, fragments) in table {
        refused(file, sets, fragments);
    }
    merged("{}", &["budget.steps=501"]);
    merged("{}", &["budget.steps=32", "replay.warmup_steps=0", "replay.capacity=32"]);
    merged("{}", &["budget.episodes=1", "replay.warmup_steps=1000000"]);
}

/// The names in the table of keys are those that the types of the config have.
#[test]
fn every_value_that_has_a_name_can_be_read() {
    for (key, _, names) in config::keys() {
        for name in names {
            if let Err(error @ ConfigError::Json { .. }) = layered("{}", &[&format!("{key}={name}")]) {
                panic!("{key}={name}: {error}");
            }
        }
    }
}

#[test]
fn a_file_that_cannot_be_read_is_named_with_the_reason() {
    let directory = tempfile::tempdir().unwrap();
    let written = |name: &str, bytes: &[u8]| {
        let path = directory.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let spaces = |count: usize| vec![b' '; count];
    let table = [
        (directory.path().join("missing.json"), "missing.json: "),
        (directory.path().to_path_buf(), "directory"),
        (written("latin1.json", b"{\"loss\": \"\xe4\"}"), "latin1.json: invalid utf-8"),
        (written("large.json", &spaces((1 << 20) + 1)), "large.json: larger than 1 MiB"),
    ];
    for (path, fragment) in table {
        let message = config::read_file(&path).unwrap_err().to_string();
        assert!(message.starts_with("cannot read ") && message.contains(fragment), "{message}");
    }
    assert_eq!(config::read_file(&written("just.json", &spaces(1 << 20))).unwrap().len(), 1 << 20);
}

#[test]
fn the_sets_of_a_layer_have_no_order() {
    let sets = ["target.kind=hard", "target.every_episodes=4", "budget.episodes=3", "exploration.decay=0.9"];
    let file = r#"{"exploration": {"schedule": "per_episode"}, "target": {"kind": "none"}, "policy_weights": "online"}"#;
    let forward = merged(file, &sets);
    let backward: Vec<&str> = sets.into_iter().rev().collect();
    assert_eq!(merged(file, &backward), forward);
    assert_eq!(
        serde_json::to_value(forward.agent.as_dqn().unwrap().target).unwrap()["every_episodes"],
        Value::from(4)
    );
}

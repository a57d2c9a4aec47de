//! The whole command line on Acrobot and MountainCar, and what a policy of another program plays.

use std::fs;

use predicates::prelude::*;
use safetensors::SafeTensors;
use serde_json::{Value, json};

use crate::cli::{Sandbox, TINY, refusals, sets, stdout_json};
use crate::resume::assert_same_runs;

const ACROBOT: &str = "Acrobot-v1";
const MOUNTAIN_CAR: &str = "MountainCar-v0";

/// [`TINY`] settings on an environment.
fn train(sandbox: &Sandbox, environment: &str, arguments: &[&str]) {
    sandbox.write("task.json", json!({"environment": environment, "replay.mirror": false}).to_string());
    let plain = ["train", "--quiet", "--config", "task.json"];
    sandbox.run(&[&plain[..], &sets(TINY)[..], arguments].concat()).success();
}

#[test]
fn an_interrupted_run_on_acrobot_and_mountain_car_has_the_bytes_of_the_undisturbed_one() {
    for environment in [ACROBOT, MOUNTAIN_CAR] {
        let sandbox = Sandbox::new();
        train(&sandbox, environment, &["--out", "whole", "--set", "budget.steps=333"]);
        // In the middle of an episode, which is played again.
        train(&sandbox, environment, &["--out", "parts", "--set", "budget.steps=137"]);
        sandbox.run(&["train", "--quiet", "--resume", "parts", "--set", "budget.steps=333"]).success();
        assert_same_runs(&sandbox, "whole", "parts");
        sandbox.run(&["verify", "parts", "--quiet"]).success().stdout("").stderr("");
    }
}

#[test]
fn eval_and_inspect_take_environment_limit_and_threshold_from_the_run() {
    for (environment, limit, threshold) in [(ACROBOT, 500, "-100"), (MOUNTAIN_CAR, 200, "-110")] {
        let sandbox = Sandbox::new();
        train(&sandbox, environment, &["--out", "run"]);
        let judged = format!("a mean ≥ {threshold} over at least 100 episodes");
        let at = format!("at {limit}");
        sandbox
            .run(&["eval", "run", "--episodes", "2"])
            .success()
            .stdout(predicate::str::contains(judged).and(predicate::str::contains(at)));
        let score = stdout_json(&sandbox.run(&["eval", "run", "--episodes", "2", "--json"]).success());
        assert_eq!(score["max_steps"], limit);
        sandbox.run(&["inspect", "run"]).success();
        let named = format!("run was trained in {environment}");
        sandbox.run(&["eval", "run", "--environment", environment, "--episodes", "1"]).success();
        let refused = sandbox.run(&["eval", "run", "--environment", "CartPole-v1"]).code(2);
        let said = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
        assert!(said.replace("/checkpoints/best.safetensors", "").contains(&named), "{said}");
    }
}

/// The policy of a run without the header that says what it is.
fn write_foreign(sandbox: &Sandbox) {
    let bytes = fs::read(sandbox.path("run/checkpoints/best.safetensors")).unwrap();
    let tensors = SafeTensors::deserialize(&bytes).unwrap();
    sandbox.write("foreign.safetensors", safetensors::serialize(tensors.tensors(), None).unwrap());
}

#[test]
fn a_policy_of_another_program_plays_the_environment_that_the_user_names() {
    let sandbox = Sandbox::new();
    train(&sandbox, MOUNTAIN_CAR, &["--out", "run"]);
    write_foreign(&sandbox);
    let eval = ["eval", "foreign.safetensors", "--episodes", "2", "--json"];
    sandbox.refuses(&eval, &["the task needs 4 inputs and 2 outputs", "--environment NAME"]);
    let named = [&eval[..], &["--environment", MOUNTAIN_CAR]].concat();
    let ours = stdout_json(&sandbox.run(&["eval", "run", "--episodes", "2", "--json"]).success());
    assert_eq!(stdout_json(&sandbox.run(&named).success())["returns"], ours["returns"]);
}

#[test]
fn a_random_policy_never_reaches_the_flag_and_every_step_costs_1() {
    let sandbox = Sandbox::new();
    let eval = ["eval", "--policy", "random", "--environment", MOUNTAIN_CAR, "--episodes", "3", "--json"];
    let score = stdout_json(&sandbox.run(&eval).success());
    assert_eq!(score["returns"], json!([-200.0, -200.0, -200.0]));
}

#[test]
fn pictures_and_pages_of_acrobot_and_mountain_car_show_the_episode_that_eval_plays() {
    for (environment, actions, delay) in [(ACROBOT, 3, 7), (MOUNTAIN_CAR, 3, 3)] {
        let sandbox = Sandbox::new();
        train(&sandbox, environment, &["--out", "run"]);
        let eval = ["eval", "run", "--episodes", "1", "--trace", "trace"];
        let score = stdout_json(&sandbox.run(&[&eval[..], &["--json"]].concat()).success());
        let trace = sandbox.read("trace");
        sandbox.run(&["render", "run", "-o", "a.svg"]).success();
        assert!(sandbox.read("a.svg").contains(&format!("{environment}, {} steps", trace.lines().count())));
        sandbox.run(&["render", "run", "-o", "a.gif", "--steps", "3"]).success();
        let file = fs::read(sandbox.path("a.gif")).unwrap();
        let mut decoder = gif::DecodeOptions::new().read_info(&file[..]).unwrap();
        assert_eq!(decoder.read_next_frame().unwrap().unwrap().delay, delay, "at the environment's speed");

        sandbox.run(&["report", "run", "--html", "page.html"]).success();
        let page = sandbox.read("page.html");
        let (_, rest) = page.split_once(r#"id="data">"#).unwrap();
        let data: Value = serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap();
        let portrait = &data["runs"][0]["portrait"];
        assert_eq!(portrait["actions"].as_array().unwrap().len(), actions);
        assert_eq!(portrait["episode"]["total"], score["returns"][0]);
        let map = &portrait["map"];
        let best = map["best"].as_array().unwrap();
        assert!(best.iter().all(|action| action.as_u64().unwrap() < actions as u64));
        // The trail is in the units of the axes, and so are their ends.
        for (axis, trail) in map["axes"].as_array().unwrap().iter().zip(map["trail"].as_array().unwrap()) {
            let (low, high) = (axis["low"].as_f64().unwrap(), axis["high"].as_f64().unwrap());
            assert_eq!(trail.as_array().unwrap().len(), trace.lines().count() + 1);
            let is_within = |value: &Value| (low - 1e-3..=high + 1e-3).contains(&value.as_f64().unwrap());
            assert!(trail.as_array().unwrap().iter().all(is_within), "{axis}: {trail}");
        }
    }
}

#[test]
fn in_a_study_a_run_that_fails_scores_the_worst_return_of_its_task() {
    let sandbox = Sandbox::new();
    for (environment, worst, threshold) in [(ACROBOT, -500.0, -100.0), (MOUNTAIN_CAR, -200.0, -110.0)] {
        sandbox.write("task.json", json!({"environment": environment, "loss": "mse"}).to_string());
        // The square of the first TD error is infinite.
        let diverging = ["reward_scale=1e30", "replay.warmup_steps=64", "budget.steps=2000"];
        let study = ["study", "--quiet", "--config", "task.json", "--seeds", "0..2", "--out", environment];
        sandbox.run(&[&study[..], &sets(&diverging)].concat()).code(1);
        sandbox.run(&["report", environment]).success();
        let report = sandbox.json(&format!("{environment}/report.json"));
        assert_eq!((&report["failed"], &report["threshold"]), (&json!(2), &json!(threshold)));
        let config = &report["configs"][0];
        assert_eq!(config["final_mean"]["value"], worst);
        let profile = config["performance_profile"].as_array().unwrap();
        assert_eq!(profile[0]["tau"], worst);
        assert!(profile.iter().all(|point| point["tau"].as_f64().unwrap() < 0.0));
    }
}

#[test]
fn an_update_on_acrobot_is_explained_and_checks_itself() {
    let sandbox = Sandbox::new();
    sandbox.write("task.json", json!({"environment": ACROBOT}).to_string());
    let explain = ["explain", "--config", "task.json", "--update", "3", "--out", "update.safetensors"];
    let small = ["replay.warmup_steps=40", "replay.batch_size=4", "network.hidden=[5]"];
    sandbox.run(&[&explain[..], &sets(&small)].concat()).success();
    sandbox.run(&["check", "update.safetensors"]).success();
}

#[test]
fn training_episodes_have_the_limit_of_the_environment_unless_the_config_has_its_own() {
    let sandbox = Sandbox::new();
    let lengths = |run: &str| -> Vec<u64> {
        let lines = sandbox.read(&format!("{run}/metrics.jsonl"));
        let events = lines.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        events.filter_map(|event| event["length"].as_u64()).collect()
    };
    train(
        &sandbox,
        MOUNTAIN_CAR,
        &["--out", "own", "--set", "budget.steps=600", "--set", "max_episode_steps=null"],
    );
    assert!(!lengths("own").is_empty() && lengths("own").iter().all(|&length| length <= 200));
    let sets = ["--set", "budget.steps=600", "--set", "max_episode_steps=30"];
    train(&sandbox, MOUNTAIN_CAR, &[&["--out", "short"], &sets[..]].concat());
    assert!(lengths("short").contains(&30) && lengths("short").iter().all(|&length| length <= 30));
}

refusals! {
    refuses_an_unknown_environment: [], ["eval", "--policy", "random", "--environment", "LunarLander-v3"]
        => ["--environment", "LunarLander-v3", "CartPole-v1", "Acrobot-v1", "MountainCar-v0", "adapters/gymnasium.py"];
    refuses_mirror_images_where_there_are_none:
        [("c.json", b"{\"environment\": \"MountainCar-v0\", \"replay.mirror\": true}")], ["train", "--config", "c.json"]
        => ["`replay.mirror` is true", "MountainCar-v0"];
}

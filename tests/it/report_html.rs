//! `report --html` as a file; tests/browser/report.cjs looks at the pages in Chromium.

use std::fs;

use serde_json::{Value, json};

use crate::cli::{Sandbox, TINY, refusals, sets};

const HOSTILE: &str = "</script><script>alert(1)</script>{{script}}<!--";

/// What the page gives its script.
fn data(page: &str) -> Value {
    let (_, rest) = page.split_once(r#"id="data">"#).unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

/// A page must need nothing else, and end each of its two scripts once.
fn check(page: &str) {
    assert!(page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>\n"));
    let page = page.replace("http://www.w3.org/2000/svg", "").replace("href=\"data:,\"", "");
    for outside in ["http:", "https:", "src=\"", "href=", "@import", "url(", "NaN", "{{title"] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert_eq!((page.matches("<script").count(), page.matches("</script>").count()), (2, 2));
}

#[test]
fn the_page_of_a_run_needs_nothing_else_and_leaves_the_run_as_it_is() {
    let sandbox = Sandbox::with_run();
    let before = sandbox.files();
    for page in ["one.html", "two.html"] {
        sandbox.run(&["report", "run", "--html", page]).success().stdout(format!("written: {page}\n"));
    }
    let page = sandbox.read("one.html");
    check(&page);
    assert!(page == sandbox.read("two.html"), "the same run gives the same page");
    assert!(before.iter().all(|(path, content)| sandbox.files().get(path) == Some(content)));
    let summary = sandbox.json("run/summary.json");
    for shown in ["Learning curve", "id=\"scene\"", "id=\"map\"", summary["weights_sha256"].as_str().unwrap()]
    {
        assert!(page.contains(shown), "{shown}");
    }
}

/// The episode is the one that `eval` plays, and the picture is of the network that chooses in it.
#[test]
fn the_policy_in_the_page_is_the_one_that_eval_plays() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "run", "--set", "reward_scale=0.5"]).success();
    sandbox.run(&["report", "run", "--html", "page.html"]).success();
    sandbox.run(&["eval", "--checkpoint", "run", "--episodes", "1", "--trace", "trace"]).success();
    let trace: Vec<Value> =
        sandbox.read("trace").lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let page = data(&sandbox.read("page.html"));
    let episode = &page["runs"][0]["portrait"]["episode"];
    assert_eq!(episode["seed"], trace[0]["seed"]);
    assert_eq!(episode["state"][0].as_array().unwrap().len(), trace.len() + 1);
    for (i, step) in trace.iter().enumerate() {
        let close = |ours: &Value, theirs: &Value| {
            let (ours, theirs) = (ours.as_f64().unwrap(), theirs.as_f64().unwrap());
            assert!((ours - theirs).abs() < 1e-4, "step {i}: {ours}, {theirs}");
        };
        assert_eq!(episode["actions"][i], step["action"], "step {i}");
        for coordinate in 0..4 {
            close(&episode["state"][coordinate][i], &step["state"][coordinate]);
        }
        for action in 0..2 {
            close(&episode["q_values"][i][action], &step["q_values"][action]);
        }
    }
    let portrait = &page["runs"][0]["portrait"];
    let size = portrait["map"]["size"].as_u64().unwrap();
    assert_eq!(portrait["map"]["best"].as_array().unwrap().len() as u64, size * size);
}

#[test]
fn several_runs_share_a_page_and_names_stay_text() {
    let sandbox = Sandbox::new();
    let hostile = HOSTILE.replace('/', "_");
    for (name, seed) in [("one", "1"), (hostile.as_str(), "2")] {
        sandbox.train(&["--out", name, "--seed", seed]).success();
    }
    let mut config = sandbox.json(&format!("{hostile}/config.json"));
    config["loss"] = json!(HOSTILE);
    sandbox.write(&format!("{hostile}/config.json"), config.to_string());
    sandbox.run(&["report", "one", &hostile, "--html", "page.html"]).success();
    let page = sandbox.read("page.html");
    check(&page);
    assert!(page.contains("&lt;/script&gt;&lt;script&gt;alert(1)") && page.contains("Where they differ"));
    assert_eq!(data(&page)["runs"][1]["name"], hostile);
}

#[test]
fn a_study_has_a_page_and_does_not_share_it() {
    let sandbox = Sandbox::with_run();
    let study = [
        &["study", "--quiet", "--seeds", "0..3", "--vary", "double=false,true", "--out", "s"],
        &sets(TINY)[..],
    ]
    .concat();
    sandbox.run(&study).success();
    sandbox.run(&["report", "s", "--html", "page.html"]).success();
    let page = sandbox.read("page.html");
    check(&page);
    for shown in ["Performance profile", "fewer than 10", "--config 0.json --config 1.json --seeds 0..3"] {
        assert!(page.contains(shown), "{shown}");
    }
    sandbox.refuses(&["report", "run", "s", "--html", "other.html"], &["s: is a study", "one study"]);
}

#[test]
fn a_run_without_a_checkpoint_still_has_a_page() {
    let sandbox = Sandbox::with_run();
    fs::remove_dir_all(sandbox.path("run/checkpoints")).unwrap();
    sandbox.run(&["report", "run", "--html", "page.html"]).success();
    let page = sandbox.read("page.html");
    assert!(page.contains("no checkpoint") && !page.contains("id=\"scene\""));
    sandbox.write("run/checkpoints/best.safetensors", "damaged");
    sandbox.refuses(&["report", "run", "--html", "other.html"], &["best.safetensors", "damaged"]);
}

/// The task of the policy is a program, which is not there and would not be started.
#[test]
#[cfg(unix)]
fn the_page_of_a_run_on_a_program_says_why_nothing_is_played_and_what_was_recorded() {
    let sandbox = Sandbox::with_run();
    let mut config = sandbox.json("run/config.json");
    let task = serde_json::to_value(cartpole_dqn::env::catalogue::EnvironmentId::CartPoleV1.spec()).unwrap();
    let mut task = task.as_object().unwrap().clone();
    task.remove("map");
    config["environment"] =
        json!({"command": ["./gone"], "processes": 1, "timeout_seconds": 60, "task": task});
    sandbox.write("run/config.json", config.to_string());
    sandbox.run(&["report", "run", "--html", "page.html"]).success();
    let page = sandbox.read("page.html");
    check(&page);
    let best = sandbox.json("run/summary.json")["best_evaluation"].clone();
    for shown in [
        "is a program, which a report does not start",
        "watch DIR --allow-command",
        &format!(">{}</td>", best["env_steps"]),
        ">smallest</th>",
    ] {
        assert!(page.contains(shown), "{shown}");
    }
    assert!(!page.contains("no checkpoint") && !page.contains("id=\"scene\""));
    fs::remove_dir_all(sandbox.path("run/checkpoints")).unwrap();
    sandbox.run(&["report", "run", "--html", "page.html"]).success();
    assert!(sandbox.read("page.html").contains("there is no checkpoint in the directory"));
}

#[test]
fn a_page_replaces_a_page_and_nothing_else() {
    let sandbox = Sandbox::with_run();
    for _ in 0..2 {
        sandbox.run(&["report", "run", "--html", "run/report.html"]).success();
    }
    sandbox.write("home.html", "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<title>My home page</title>");
    for file in ["run/metrics.jsonl", "home.html"] {
        sandbox.refuses(&["report", "run", "--html", file], &[file, "not a page of `report`"]);
    }
    sandbox.refuses(&["report", "run", "--html", "run"], &["a directory"]);
    sandbox.refuses(&["report", "run", "--html", "no/p.html"], &["--html no/p.html", "no directory no"]);
    // The page is part of the run: --force may replace both.
    sandbox.train(&["--out", "run", "--force"]).success();
    assert!(!sandbox.path("run/report.html").exists());
}

#[test]
fn runs_of_the_same_name_are_told_apart_and_a_page_goes_to_standard_output() {
    let sandbox = Sandbox::new();
    for out in ["a/x/run", "b/x/run", "other"] {
        sandbox.train(&["--quiet", "--out", out]).success();
    }
    let before = sandbox.files();
    let output = sandbox.run(&["report", "a/x/run", "b/x/run", "other", "--html", "-"]).success().stderr("");
    let page = String::from_utf8(output.get_output().stdout.clone()).unwrap();
    check(&page);
    let names: Vec<Value> =
        data(&page)["runs"].as_array().unwrap().iter().map(|run| run["name"].clone()).collect();
    assert_eq!(names, ["a/x/run", "b/x/run", "other"]);
    assert!(page.contains("the bold line is the mean return of an evaluation"));
    assert!(before == sandbox.files());
    sandbox.refuses(&["report", "other", "other", "--html", "-"], &["other: is given twice"]);
}

refusals! {
    refuses_a_page_of_nothing: [], ["report", "--html", "page.html"] => ["DIR"];
    refuses_a_page_of_something_else: [("r/notes.txt", b"mine")], ["report", "r", "--html", "page.html"] => ["r: is neither a study", "nor a run"];
    refuses_several_directories_without_a_page: [], ["report", "a", "b"] => ["several directories need --html"];
    refuses_a_page_and_a_directory: [], ["report", "a", "--html", "p", "--out", "o"] => ["--html", "--out"];
}

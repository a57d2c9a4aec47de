//! The commands for looking: `render`, and `watch` and `train --live` where there is no terminal.

use std::fs;

use predicates::prelude::*;

use crate::cli::{Sandbox, refusals};

const BEST: &str = "run/checkpoints/best.safetensors";

refusals! {
    refuses_to_render_without_a_checkpoint: [], ["render", "-o", "x.gif"] => ["no path is given"];
    refuses_to_render_what_is_no_checkpoint:
        [("x", b"hello")], ["render", "--checkpoint", "x", "-o", "x.gif"] => ["x", "not a safetensors file"];
    refuses_a_picture_of_another_kind:
        [("x", b"")], ["render", "--checkpoint", "x", "-o", "x.png"] => ["x.png", ".gif or .svg"];
    refuses_a_picture_without_an_extension:
        [("x", b"")], ["render", "--checkpoint", "x", "-o", "gif"] => ["gif", ".gif or .svg"];
    refuses_a_picture_that_is_a_directory:
        [("f.gif/x", b"")], ["render", "--checkpoint", "x", "-o", "f.gif"] => ["f.gif", "directory"];
    refuses_to_train_live_without_a_terminal: [], ["train", "--live"] => ["needs a terminal"];
    refuses_a_pace_without_live: [], ["train", "--pace", "5x"] => ["--live"];
    refuses_a_pace_that_is_no_factor: [], ["train", "--live", "--pace", "fast"] => ["--pace", "0.01x to 1000x"];
    refuses_a_pace_of_zero: [], ["train", "--live", "--pace", "0x"] => ["--pace", "0.01x to 1000x"];
    refuses_to_be_live_and_quiet: [], ["train", "--live", "--quiet"] => ["--live", "--quiet"];
    refuses_to_watch_nothing: [], ["watch"] => ["no path is given"];
    refuses_to_watch_what_is_no_checkpoint:
        [("x", b"hello")], ["watch", "--checkpoint", "x"] => ["x", "not a safetensors file"];
    refuses_a_picture_of_no_steps:
        [], ["render", "--checkpoint", "x", "-o", "x.gif", "--steps", "0"] => ["--steps", "from 1 to 1000000"];
}

#[test]
fn does_not_draw_over_the_checkpoint_or_into_a_missing_directory() {
    let sandbox = Sandbox::with_run();
    fs::copy(sandbox.path(BEST), sandbox.path("policy.gif")).unwrap();
    let render = ["render", "--checkpoint", "policy.gif", "-o"];
    sandbox.refuses(&[&render[..], &["policy.gif"]].concat(), &["policy.gif", "would be lost"]);
    sandbox.refuses(&[&render[..], &["no/x.gif"]].concat(), &["no/x.gif", "No such file"]);
}

#[test]
fn refuses_to_watch_without_a_terminal() {
    Sandbox::with_run().refuses(&["watch", "--checkpoint", "run"], &["needs a terminal"]);
}

#[test]
fn pictures_show_the_episode_that_eval_plays() {
    let sandbox = Sandbox::with_run();
    let eval = ["eval", "--checkpoint", "run", "--episodes", "1", "--seed", "5", "--trace", "trace"];
    sandbox.run(&eval).success();
    let steps = sandbox.read("trace").lines().count();
    for (file, drawn) in [("a.gif", steps), ("b.gif", 3), ("c.svg", steps)] {
        let limit = drawn.to_string();
        let arguments =
            ["render", "--checkpoint", "run", "--seed", "5", "-o", file, "--steps", limit.as_str()];
        // The whole episode needs no limit.
        let arguments = if drawn == steps { &arguments[..7] } else { &arguments };
        let said = format!("{file}: {drawn} steps from Gymnasium's seed 5\n");
        sandbox.run(arguments).success().stdout(said).stderr("");
        let first = fs::read(sandbox.path(file)).unwrap();
        sandbox.run(arguments).success();
        assert!(first == fs::read(sandbox.path(file)).unwrap(), "{file} differs from itself");
        if file.ends_with("gif") {
            assert_eq!(delays(&first), [vec![2; drawn], vec![100]].concat(), "one frame per state");
        } else {
            let text = String::from_utf8(first).unwrap();
            let values = text.split_once("values=\"").unwrap().1.split_once('"').unwrap().0;
            assert_eq!(values.split(';').count(), drawn + 1 + 50, "one position per state, the last held");
            assert!(predicate::str::contains("type=\"rotate\"").eval(&text));
        }
    }
}

/// How long each frame of a GIF of the right size is shown, in hundredths of a second.
fn delays(file: &[u8]) -> Vec<u16> {
    let mut decoder = gif::DecodeOptions::new().read_info(file).unwrap();
    assert_eq!((decoder.width(), decoder.height()), (600, 400));
    let mut delays = Vec::new();
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        delays.push(frame.delay);
    }
    delays
}

#[test]
fn draws_over_a_picture_of_its_own_kind_and_over_nothing_else() {
    let sandbox = Sandbox::with_run();
    let render = |file| ["render", "run", "--steps", "2", "-o", file];
    for (file, own) in [("a.gif", "b.gif"), ("a.svg", "b.svg")] {
        sandbox.run(&render(own)).success();
        sandbox.run(&render(own)).success();
        sandbox.write(file, "");
        sandbox.run(&render(file)).success();
    }
    sandbox.write("mine.gif", b"GIF89a\x10\x00\x10\x00 a picture of somebody else");
    sandbox.write("mine.svg", "<svg xmlns=\"http://www.w3.org/2000/svg\"><title>mine</title></svg>");
    fs::copy(sandbox.path("a.svg"), sandbox.path("svg.gif")).unwrap();
    for file in ["mine.gif", "mine.svg", "svg.gif"] {
        sandbox.refuses(&render(file), &[file, "`render`", "would be lost"]);
    }
}

#[test]
fn a_picture_on_standard_output_has_the_bytes_of_the_file() {
    let sandbox = Sandbox::with_run();
    for (format, file) in [("gif", "a.gif"), ("svg", "a.svg")] {
        sandbox
            .run(&["render", "run", "--steps", "3", "-o", file, "--quiet"])
            .success()
            .stdout("")
            .stderr("");
        let piped = sandbox.run(&["render", "run", "--steps", "3", "-o", "-", "--format", format]).success();
        assert!(piped.get_output().stdout == fs::read(sandbox.path(file)).unwrap(), "{format}");
        let default =
            sandbox.run(&["render", "run", "--steps", "3", "-o", "-", "--quiet"]).success().stderr("");
        assert!(default.get_output().stdout.starts_with(b"GIF89a"));
    }
}

#[test]
fn inspect_shows_step_score_and_the_hash_that_train_printed_and_no_more() {
    let sandbox = Sandbox::new();
    let printed =
        sandbox.train(&["--out", "run2", "--set", "observation_divisors=[2,2,2,2]", "--json"]).success();
    let hash = crate::cli::stdout_json(&printed)["weights_sha256"].as_str().unwrap().to_owned();
    let last = "run2/checkpoints/last.safetensors";
    let inspected = sandbox.run(&["inspect", last]).success().stderr("");
    let text = String::from_utf8(inspected.get_output().stdout.clone()).unwrap();
    for part in
        ["step        200 of the run", "evaluation  mean return", "at step 200", &hash, "train prints"]
    {
        assert!(text.contains(part), "{part} is not in {text}");
    }
    assert_eq!(text.matches("sha256 ").count(), 2, "{text}");
    assert!(text.lines().all(|line| line.chars().count() <= 80) && text.lines().count() < 15, "{text}");
    let best = sandbox.run(&["inspect", "run2"]).success();
    let text = String::from_utf8(best.get_output().stdout.clone()).unwrap();
    assert!(text.contains("its best") && text.contains(&format!("not shown   {last}")), "{text}");
    assert!(!text.contains("gamma") && !text.contains("0.weight"), "{text}");
}

#[cfg(not(feature = "web"))]
#[test]
fn a_program_without_the_page_has_no_command_for_it() {
    let sandbox = Sandbox::new();
    sandbox.refuses(&["web", "--out", "site"], &["unrecognized subcommand 'web'"]);
    sandbox.run(&["--help"]).success().stdout(predicate::str::contains("web").not());
    sandbox.run(&["__words", "--", "w"]).success().stdout(predicate::str::contains("web").not());
}

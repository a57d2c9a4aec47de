//! The commands for looking: `render`, and `watch` and `train --live` where there is no terminal.

use std::fs;

use predicates::prelude::*;

use crate::cli::{Sandbox, refusals};

const BEST: &str = "run/checkpoints/best.safetensors";

refusals! {
    refuses_to_render_without_a_checkpoint: [], ["render", "-o", "x.gif"] => ["--checkpoint"];
    refuses_to_render_what_is_no_checkpoint:
        [("x", b"hello")], ["render", "--checkpoint", "x", "-o", "x.gif"] => ["x", "not a safetensors file"];
    refuses_a_picture_of_another_kind:
        [("x", b"")], ["render", "--checkpoint", "x", "-o", "x.png"] => ["x.png", ".gif or .svg"];
    refuses_a_picture_without_an_extension:
        [("x", b"")], ["render", "--checkpoint", "x", "-o", "gif"] => ["gif", ".gif or .svg"];
    refuses_a_picture_that_is_a_folder:
        [("f.gif/x", b"")], ["render", "--checkpoint", "x", "-o", "f.gif"] => ["f.gif", "folder"];
    refuses_to_train_live_without_a_terminal: [], ["train", "--live"] => ["not a terminal"];
    refuses_a_pace_without_live: [], ["train", "--pace", "5x"] => ["--live"];
    refuses_a_pace_that_is_no_factor: [], ["train", "--live", "--pace", "fast"] => ["--pace", "0.01x to 1000x"];
    refuses_a_pace_of_zero: [], ["train", "--live", "--pace", "0x"] => ["--pace", "0.01x to 1000x"];
    refuses_to_be_live_and_quiet: [], ["train", "--live", "--quiet"] => ["--live", "--quiet"];
    refuses_to_watch_nothing: [], ["watch"] => ["--checkpoint"];
    refuses_to_watch_what_is_no_checkpoint:
        [("x", b"hello")], ["watch", "--checkpoint", "x"] => ["x", "not a safetensors file"];
    refuses_a_picture_of_no_steps:
        [], ["render", "--checkpoint", "x", "-o", "x.gif", "--steps", "0"] => ["--steps", "from 1 to 500"];
}

#[test]
fn does_not_draw_over_the_checkpoint_or_into_a_missing_folder() {
    let sandbox = Sandbox::with_run();
    fs::copy(sandbox.path(BEST), sandbox.path("policy.gif")).unwrap();
    let render = ["render", "--checkpoint", "policy.gif", "-o"];
    sandbox.refuses(&[&render[..], &["policy.gif"]].concat(), &["policy.gif", "it is the checkpoint"]);
    sandbox.refuses(&[&render[..], &["no/x.gif"]].concat(), &["no/x.gif", "No such file"]);
}

#[test]
fn refuses_to_watch_without_a_terminal() {
    Sandbox::with_run().refuses(&["watch", "--checkpoint", "run"], &["not a terminal"]);
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

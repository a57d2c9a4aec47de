//! The command line: `eval` and `inspect`.

use std::collections::HashMap;
use std::fs;

use cartpole_dqn::run::seal;
use predicates::prelude::*;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::{Value, json};

use crate::cli::{Sandbox, keys, refusals, stdout_json};

const BEST: &str = "run/checkpoints/best.safetensors";
const LAST: &str = "run/checkpoints/last.safetensors";
const FOREIGN: &str = "foreign.safetensors";

refusals! {
    refuses_eval_where_nothing_is_trained:
        [], ["eval"] => ["no path is given", "no directory runs", "cartpole-dqn train"];
    refuses_a_missing_checkpoint: [], ["eval", "--checkpoint", "x"] => ["x", "No such file", "directory of a run"];
    refuses_an_empty_checkpoint: [("x", b"")], ["eval", "--checkpoint", "x"] => ["x", "not a safetensors file"];
    refuses_random_bytes_as_checkpoint:
        [("x", &[0x5a; 999])], ["eval", "--checkpoint", "x"] => ["x", "not a safetensors file"];
    refuses_a_config_as_checkpoint:
        [("x.json", b"{\"gamma\": 0.9}")], ["eval", "--checkpoint", "x.json"]
        => ["x.json", "not a safetensors file", "give a .safetensors file"];
    refuses_a_directory_without_a_checkpoint:
        [("run/config.json", b"{}")], ["eval", "--checkpoint", "run"] => ["directory run", "best.safetensors"];
    refuses_to_inspect_what_is_no_checkpoint:
        [("x", b"hello, world")], ["inspect", "--checkpoint", "x"] => ["x", "not a safetensors file"];
    refuses_zero_episodes: [], ["eval", "--policy", "random", "--episodes", "0"] => ["--episodes", "'0'", "from 1 to 10000000"];
    refuses_seeds_beyond_the_largest:
        [], ["eval", "--policy", "random", "--seed", "18446744073709551615", "--episodes", "2"]
        => ["--seed 18446744073709551615", "--episodes 2", "largest seed"];
    refuses_a_minimum_that_is_no_number:
        [], ["eval", "--policy", "random", "--min-mean", "nan"] => ["--min-mean", "'nan'", "finite"];
    refuses_an_unknown_policy: [], ["eval", "--policy", "randm"] => ["'randm'", "random"];
    refuses_a_policy_beside_a_checkpoint:
        [], ["eval", "--policy", "random", "--checkpoint", "x"] => ["--policy", "--checkpoint"];
    refuses_a_trace_in_a_missing_directory:
        [], ["eval", "--policy", "random", "--trace", "no/x"] => ["--trace no/x: No such file"];
    refuses_a_trace_below_a_file:
        [("f", b"mine")], ["eval", "--policy", "random", "--trace", "f/x"] => ["--trace f/x: Not a directory"];
    refuses_a_trace_that_is_a_directory:
        [("f/x", b"mine")], ["eval", "--policy", "random", "--trace", "f"] => ["--trace f", "directory"];
    refuses_a_path_twice: [], ["eval", "a", "--checkpoint", "b"] => ["PATH", "--checkpoint"];
    refuses_the_trials_of_a_study:
        [("s/study.json", b"{}")], ["eval", "s"] => ["s is a study", "no policies", "train --config"];
    refuses_two_things_on_standard_output:
        [], ["eval", "--policy", "random", "--trace", "-", "--json"] => ["--trace -", "--json"];
    refuses_an_empty_standard_input: [], ["eval", "-"] => ["standard input", "not a safetensors file"];
}

#[test]
fn refuses_a_checkpoint_cut_off_anywhere() {
    let sandbox = Sandbox::with_run();
    let whole = fs::read(sandbox.path(BEST)).unwrap();
    let header = 8 + usize::try_from(u64::from_le_bytes(whole[..8].try_into().unwrap())).unwrap();
    for length in [1, 7, 8, 9, header - 1, header, header + 1, whole.len() - 1] {
        sandbox.write("cut", &whole[..length]);
        for command in ["eval", "inspect"] {
            sandbox.refuses(&[command, "--checkpoint", "cut"], &["checkpoint cut", "cut off"]);
        }
    }
}

#[test]
fn refuses_to_write_the_trace_over_the_checkpoint() {
    let sandbox = Sandbox::with_run();
    sandbox.refuses(&["eval", "--checkpoint", "run", "--trace", BEST], &["--trace", "would be lost"]);
}

/// A file as PyTorch users write it: no metadata, each tensor (name, shape, values).
fn write_foreign(sandbox: &Sandbox, tensors: &[(&str, &[usize], &[f32])]) {
    let bytes: Vec<Vec<u8>> =
        tensors.iter().map(|(.., values)| values.iter().flat_map(|x| x.to_le_bytes()).collect()).collect();
    let views: HashMap<&str, TensorView<'_>> = tensors
        .iter()
        .zip(&bytes)
        .map(|((name, shape, _), bytes)| (*name, TensorView::new(Dtype::F32, shape.to_vec(), bytes).unwrap()))
        .collect();
    sandbox.write(FOREIGN, safetensors::serialize(&views, None).unwrap());
}

/// Pushes to the side to which the pole falls: Q = (max(−s, 0), max(s, 0)) where s = θ + θ̇.
const FOLLOW_THE_POLE: [(&str, &[usize], &[f32]); 4] = [
    ("0.weight", &[2, 4], &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, -1.0, -1.0]),
    ("0.bias", &[2], &[0.0, 0.0]),
    ("2.weight", &[2, 2], &[0.0, 1.0, 1.0, 0.0]),
    ("2.bias", &[2], &[0.0, 0.0]),
];

#[test]
fn refuses_networks_that_do_not_fit_the_task() {
    let weights = [0.0; 12];
    let [weight, bias, weight2, bias2] = FOLLOW_THE_POLE;
    let three_inputs = [("0.weight", &[2, 3][..], &weights[..6]), bias];
    let three_actions = [("0.weight", &[3, 4][..], &weights[..12]), ("0.bias", &[3], &weights[..3])];
    let broken_chain = [weight, bias, ("2.weight", &[2, 3][..], &weights[..6]), bias2];
    let infinite = [weight, ("0.bias", &[2][..], &[f32::INFINITY, 0.0][..]), weight2, bias2];
    let cases: [(&[_], &[&str]); 5] = [
        (&three_inputs, &["[3, 2]", "4 inputs and 2 outputs"]),
        (&three_actions, &["[4, 3]", "4 inputs and 2 outputs"]),
        (&broken_chain, &["`2.weight`", "[2, 3]"]),
        (&[weight, bias, weight2], &["holds no policy", "`2.weight`"]),
        (&infinite, &["`0.bias`", "infinity"]),
    ];
    for (tensors, words) in cases {
        let sandbox = Sandbox::new();
        write_foreign(&sandbox, tensors);
        sandbox.refuses(&["eval", "--checkpoint", FOREIGN], &[&[FOREIGN], words].concat());
    }
}

#[test]
fn plays_a_policy_under_the_names_of_other_programs() {
    let returns = |sandbox: &Sandbox| {
        let arguments = ["eval", "--checkpoint", FOREIGN, "--episodes", "3", "--seed", "7", "--json"];
        stdout_json(&sandbox.run(&arguments).success())["returns"].clone()
    };
    let sandbox = Sandbox::new();
    write_foreign(&sandbox, &FOLLOW_THE_POLE);
    let expected = returns(&sandbox);
    let [(_, weight, weights), (_, bias, biases), (_, weight2, weights2), (_, bias2, biases2)] =
        FOLLOW_THE_POLE;
    let under = |first: &str, second: &str| {
        let names = [first, second].map(|stem| ["weight", "bias"].map(|kind| format!("{stem}.{kind}")));
        let shapes = [[(weight, weights), (bias, biases)], [(weight2, weights2), (bias2, biases2)]];
        let both = names.into_iter().flatten().zip(shapes.into_iter().flatten());
        both.map(|(name, (shape, values))| (name, shape, values)).collect::<Vec<_>>()
    };
    fn borrowed<'a>(
        tensors: &'a [(String, &'a [usize], &'a [f32])],
    ) -> Vec<(&'a str, &'a [usize], &'a [f32])> {
        tensors.iter().map(|(name, shape, values)| (name.as_str(), *shape, *values)).collect()
    }
    for [first, second] in
        [["network.0", "network.2"], ["q_net.q_net.0", "q_net.q_net.2"], ["layer1", "layer2"], ["1", "3"]]
    {
        let own = under(first, second);
        write_foreign(&sandbox, &borrowed(&own));
        assert_eq!(returns(&sandbox), expected, "{first}");
        // A target network beside it is not meant.
        let target = under(&format!("target_{first}"), &format!("target_{second}"));
        write_foreign(&sandbox, &borrowed(&[own, target].concat()));
        assert_eq!(returns(&sandbox), expected, "{first} with a target network");
    }
    // No activation between, two networks, and a gap that could be a layer of its own.
    let (a, b) = (under("a.0", "a.2"), under("b.0", "b.2"));
    for tensors in [under("0", "1"), [a, b].concat(), under("a.0", "a.5"), under("layer1", "out")] {
        write_foreign(&sandbox, &borrowed(&tensors));
        sandbox.refuses(
            &["eval", FOREIGN],
            &["holds no policy", "save_file({f\"{2 * i}.{n}\": getattr(layer, n)"],
        );
    }
}

#[test]
fn plays_the_f64_of_numpy() {
    let sandbox = Sandbox::new();
    write_foreign(&sandbox, &FOLLOW_THE_POLE);
    let eval = ["eval", FOREIGN, "--episodes", "3", "--json"];
    let expected = stdout_json(&sandbox.run(&eval).success())["returns"].clone();
    let wide = FOLLOW_THE_POLE.map(|(name, shape, values)| {
        let bytes: Vec<u8> = values.iter().flat_map(|&value| f64::from(value).to_le_bytes()).collect();
        (name, shape, bytes)
    });
    let views = wide
        .iter()
        .map(|(name, shape, bytes)| (*name, TensorView::new(Dtype::F64, shape.to_vec(), bytes).unwrap()));
    sandbox.write(FOREIGN, safetensors::serialize(views, None).unwrap());
    assert_eq!(stdout_json(&sandbox.run(&eval).success())["returns"], expected);
}

#[test]
fn says_what_a_file_of_another_format_is_and_how_its_weights_are_saved() {
    let sandbox = Sandbox::new();
    let rest = [7_u8; 100];
    for (name, start, kind) in [
        ("policy.pt", &b"PK\x03\x04\x14\0\0\0"[..], "a zip archive"),
        ("model.keras", b"PK\x03\x04\x14\0\0\0", "a zip archive"),
        ("model.h5", b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
        ("policy.pkl", b"\x80\x04\x95\x10\0\0\0\0", "a pickle"),
        ("weights.npy", b"\x93NUMPY\x01\0", "an array of NumPy"),
        ("policy.onnx", b"\x08\x07\x12\x07pytorch", "an ONNX file"),
    ] {
        sandbox.write(name, [start, &rest].concat());
        let words = [name, kind, "no safetensors file", "import save_file; save_file("];
        for command in [&["eval", name][..], &["inspect", name], &["check", name]] {
            sandbox.refuses(command, &words);
        }
        let sent =
            sandbox.assert(sandbox.command(&["eval", "-"]).write_stdin([start, &rest].concat())).code(2);
        assert!(String::from_utf8_lossy(&sent.get_output().stderr).contains(kind));
    }
}

#[test]
fn standard_input_has_two_names() {
    let sandbox = Sandbox::with_run();
    let best = std::fs::read(sandbox.path(BEST)).unwrap();
    let eval = |place: &str| {
        let sent = sandbox
            .assert(sandbox.command(&["eval", place, "--episodes", "2", "--json"]).write_stdin(best.clone()));
        stdout_json(&sent.success())["returns"].clone()
    };
    assert_eq!(eval("-"), eval("/dev/stdin"));
}

#[test]
fn plays_a_file_of_another_program_and_traces_every_step() {
    let sandbox = Sandbox::new();
    write_foreign(&sandbox, &FOLLOW_THE_POLE);
    let arguments = ["eval", "--checkpoint", FOREIGN, "--episodes", "3", "--seed", "7", "--json"];
    let report = stdout_json(&sandbox.run(&[&arguments[..], &["--trace", "t.jsonl"]].concat()).success());
    assert_eq!(report, stdout_json(&sandbox.run(&arguments).success()), "the trace changes nothing");

    let trace = sandbox.read("t.jsonl");
    let mut lengths = [0_u64; 3];
    for line in trace.lines() {
        let line: Value = serde_json::from_str(line).unwrap();
        let expected =
            ["action", "episode", "q_values", "reward", "seed", "state", "step", "terminated", "truncated"];
        assert_eq!(keys(&line), expected);
        let episode = line["episode"].as_u64().unwrap();
        let length = &mut lengths[usize::try_from(episode).unwrap()];
        assert_eq!((&line["seed"], &line["step"]), (&json!(7 + episode), &json!(*length)));
        *length += 1;
        assert_eq!(line["reward"], 1.0);

        let state: [f64; 4] = serde_json::from_value(line["state"].clone()).unwrap();
        let falling = state[2] as f32 + state[3] as f32;
        let q_values: [f32; 2] = serde_json::from_value(line["q_values"].clone()).unwrap();
        assert!(
            (q_values[0] - (-falling).max(0.0)).abs() < 1e-6 && (q_values[1] - falling.max(0.0)).abs() < 1e-6
        );
        assert_eq!(line["action"], u64::from(q_values[1] > q_values[0]));
        let ended = line["terminated"] == true || line["truncated"] == true;
        assert_eq!(ended, report["returns"][usize::try_from(episode).unwrap()] == *length as f64);
    }
    assert_eq!(report["returns"], json!(lengths.map(|length| length as f64)));
    assert!(
        lengths.iter().all(|&length| length > 100),
        "a policy that follows the pole is no bad one: {lengths:?}"
    );
}

#[test]
fn json_prints_the_score_alone() {
    let assert = Sandbox::new().run(&["eval", "--policy", "random", "--json"]).success();
    let report = stdout_json(&assert);
    let expected = [
        "episodes",
        "max",
        "max_steps",
        "mean",
        "median",
        "min",
        "policy",
        "returns",
        "seed",
        "solved",
        "std",
    ];
    assert_eq!(keys(&report), expected);
    let returns: Vec<f64> = serde_json::from_value(report["returns"].clone()).unwrap();
    let mean = returns.iter().sum::<f64>() / 100.0;
    assert_eq!((returns.len(), &report["episodes"], &report["seed"]), (100, &json!(100), &json!(2_000_000)));
    assert_eq!(report["mean"], mean);
    assert_eq!(report["solved"], false);
    assert!((15.0..30.0).contains(&mean), "a random policy falls after some 22 steps: {mean}");
    assert!(predicate::str::is_empty().eval(&String::from_utf8_lossy(&assert.get_output().stderr)));
}

#[test]
fn the_mean_decides_the_exit_code_if_asked_to() {
    let sandbox = Sandbox::new();
    let eval = |minimum| sandbox.run(&["eval", "--policy", "random", "--min-mean", minimum]);
    eval("5").success().stderr("");
    let below = predicate::str::contains("below --min-mean 475");
    eval("475").code(1).stdout(predicate::str::contains("mean return")).stderr(below);
}

#[test]
fn a_run_is_played_by_its_best_checkpoint_or_else_its_last() {
    let sandbox = Sandbox::with_run();
    let inspected = |file| predicate::str::contains(format!("file        {file}\n"));
    sandbox.run(&["inspect", "--checkpoint", "run"]).success().stdout(inspected(BEST));
    fs::remove_file(sandbox.path(BEST)).unwrap();
    sandbox.run(&["inspect", "--checkpoint", "run"]).success().stdout(inspected(LAST));
    let [directory, file] = ["run", LAST].map(|path| {
        stdout_json(&sandbox.run(&["eval", "--checkpoint", path, "--episodes", "3", "--json"]).success())
    });
    assert_eq!(directory, file);
}

#[test]
fn inspect_tells_what_is_in_a_file() {
    let sandbox = Sandbox::with_run();
    write_foreign(&sandbox, &FOLLOW_THE_POLE);
    let policy = "layers [4, 8, 2]";
    for (file, words) in [
        (
            BEST,
            vec![
                "version 3: policy of the run, its best\n",
                policy,
                "evaluation  mean return",
                "\"gamma\": 0.99",
                "0.weight F32 [8, 4]",
            ],
        ),
        (LAST, vec!["policy and state of the run", policy, "step        200", "replay.actions U8 [200]"]),
        (FOREIGN, vec!["written by another program", "layers [4, 2, 2]", "2.bias F32 [2]"]),
    ] {
        let assert = sandbox.run(&["inspect", "--checkpoint", file, "--all"]).success().stderr("");
        let text = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
        assert!(words.iter().all(|word| text.contains(word)), "{words:?} not in {text}");
        assert_eq!(text.contains("replay."), file == LAST);
    }
}

#[test]
#[cfg(unix)]
fn a_trace_to_a_device_leaves_it_a_device() {
    let sandbox = Sandbox::new();
    let arguments = ["eval", "--policy", "random", "--episodes", "1", "--trace", "/dev/stdout", "--json"];
    let assert = sandbox.run(&arguments).success();
    let text = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
    assert!(text.starts_with("{\"episode\":0,") && text.contains("\"returns\""), "{text}");
}

#[test]
fn refuses_a_checkpoint_of_another_format_version() {
    let sandbox = Sandbox::with_run();
    let path = sandbox.path(BEST);
    let mut bytes = fs::read(&path).unwrap();
    let version = br#"\"format_version\":3"#;
    let position = bytes.windows(version.len()).position(|window| window == version).unwrap();
    bytes[position + version.len() - 1] = b'9';
    seal(&mut bytes);
    fs::write(&path, bytes).unwrap();
    for command in ["eval", "inspect"] {
        sandbox.refuses(&[command, "--checkpoint", BEST], &[BEST, "format version 9", "version 3"]);
    }
}

#[test]
fn a_score_in_training_of_an_earlier_policy_is_not_given_to_the_last_one() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "run", "--set", "budget.steps=250"]).success();
    let last = sandbox.json("run/summary.json")["final_evaluation"]["mean"].as_f64().unwrap();
    // The end of the run has an evaluation of its own, which the checkpoint cannot know: its bytes are those of a longer run.
    for evaluated in [
        format!("step 250, evaluated in training: {last:.2}\n"),
        "step 250, evaluated in training at step 200: ".into(),
    ] {
        let said = predicates::str::contains(format!("last of its run, {evaluated}"));
        sandbox.run(&["eval", LAST, "--episodes", "2"]).success().stdout(said);
        let _ = fs::remove_file(sandbox.path("run/summary.json"));
    }
}

#[test]
fn eval_says_which_policy_of_which_step_it_played() {
    let sandbox = Sandbox::with_run();
    let summary = sandbox.json("run/summary.json");
    for (path, file, kind, evaluation) in
        [("run", BEST, "best", "best_evaluation"), (LAST, LAST, "last", "final_evaluation")]
    {
        let (step, mean) = (&summary[evaluation]["env_steps"], summary[evaluation]["mean"].as_f64().unwrap());
        let played =
            &stdout_json(&sandbox.run(&["eval", path, "--episodes", "2", "--json"]).success())["policy"];
        assert_eq!((&played["kind"], &played["file"]), (&json!(kind), &json!(file)));
        assert_eq!((&played["env_steps"], &played["evaluation"]["mean"]), (step, &json!(mean)));
        assert_eq!(played["weights_sha256"].as_str().unwrap().len(), 64);
        let said =
            format!("policy         {kind} of its run, step {step}, evaluated in training: {mean:.2}\n");
        let assert = sandbox.run(&["eval", path, "--episodes", "2"]).success().stderr("");
        let text = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
        assert!(text.starts_with(&said) && text.contains(&format!("file           {file}\n")), "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
        // Of a run whose best policy is not its last one, eval names the last one too.
        let is_other = file == BEST && summary["best_evaluation"] != summary["final_evaluation"];
        assert_eq!(text.contains(&format!("               {LAST}\n")), is_other, "{text}");
    }
    sandbox.run(&["eval", "run", "--episodes", "2", "--quiet"]).success().stdout("").stderr("");
}

#[test]
fn a_trace_overwrites_a_trace_and_nothing_else() {
    let sandbox = Sandbox::with_run();
    let eval = |trace| ["eval", "run", "--episodes", "1", "--trace", trace];
    sandbox.run(&eval("trace")).success();
    sandbox.run(&eval("trace")).success();
    sandbox.write("mine.txt", "notes");
    sandbox.write("log.jsonl", "{\"episode\":1,\"return\":20}\n");
    for file in
        ["mine.txt", "log.jsonl", "run/metrics.jsonl", "run/config.json", LAST, BEST, "run/summary.json"]
    {
        sandbox.refuses(&eval(file), &[file, "is not a trace", "would be lost"]);
    }
}

#[test]
fn standard_input_and_output_take_the_place_of_files() {
    let sandbox = Sandbox::with_run();
    let piped = |arguments: &[&str]| {
        sandbox
            .assert(sandbox.command(arguments).write_stdin(fs::read(sandbox.path(BEST)).unwrap()))
            .success()
    };
    let of_file = stdout_json(&sandbox.run(&["eval", "run", "--episodes", "2", "--json"]).success());
    let of_pipe = stdout_json(&piped(&["eval", "-", "--episodes", "2", "--json"]));
    assert_eq!(of_pipe["returns"], of_file["returns"]);
    assert_eq!(of_pipe["policy"]["file"], "standard input");

    sandbox.run(&["eval", "run", "--episodes", "2", "--trace", "trace"]).success();
    let score = predicate::str::contains("mean return");
    let traced = sandbox.run(&["eval", "run", "--episodes", "2", "--trace", "-"]).success().stderr(score);
    assert!(traced.get_output().stdout == fs::read(sandbox.path("trace")).unwrap());
    sandbox.run(&["eval", "run", "--episodes", "2", "--trace", "-", "--quiet"]).success().stderr("");
}

/// The bytes of a checkpoint are those of the network that was trained on scaled rewards; what is shown is not.
#[test]
fn q_values_are_in_raw_rewards_and_the_scale_changes_no_action() {
    use cartpole_dqn::run::Checkpoint;
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "run", "--set", "reward_scale=0.01"]).success();
    let mut bare = Checkpoint::default();
    bare.tensors = Checkpoint::read(&sandbox.path(BEST)).unwrap().tensors;
    sandbox.write(FOREIGN, bare.to_bytes().unwrap());
    let [scaled, raw] = [BEST, FOREIGN].map(|file| {
        sandbox.run(&["eval", file, "--episodes", "3", "--trace", "trace"]).success();
        let trace = sandbox.read("trace");
        trace.lines().map(|line| serde_json::from_str(line).unwrap()).collect::<Vec<Value>>()
    });
    assert_eq!(scaled.len(), raw.len());
    for (scaled, raw) in scaled.iter().zip(&raw) {
        assert_eq!((&scaled["action"], &scaled["state"]), (&raw["action"], &raw["state"]));
        for action in 0..2 {
            let [scaled, raw] = [scaled, raw].map(|line| line["q_values"][action].as_f64().unwrap());
            assert!((scaled - raw * 100.0).abs() <= 1e-5 * scaled.abs(), "{scaled}, {raw}");
        }
    }
}

#[test]
fn names_from_a_file_are_escaped() {
    let sandbox = Sandbox::new();
    write_foreign(&sandbox, &[("\u{1b}]0;owned\u{7}", &[1], &[0.0])]);
    let assert = sandbox.run(&["inspect", "--all", FOREIGN]).success();
    let text = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
    assert!(text.contains("\\u{1b}]0;owned\\u{7}") && !text.contains('\u{1b}'), "{text}");
}

#[test]
#[cfg(unix)]
fn a_checkpoints_directory_that_cannot_be_searched_is_not_called_empty() {
    let sandbox = Sandbox::new();
    sandbox.write("run/config.json", "{}");
    std::os::unix::fs::symlink("checkpoints", sandbox.path("run/checkpoints")).unwrap();
    let refused = sandbox.run(&["eval", "run"]).code(2);
    let message = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
    assert!(message.contains("cannot be searched") && !message.contains("has no"), "{message}");
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_is_a_failure_and_no_bad_input() {
    let sandbox = Sandbox::with_run();
    let full = predicate::str::contains("No space left");
    for arguments in [["eval", "run", "--trace", "/dev/full"], ["render", "run", "-o", "full.gif"]] {
        if arguments[0] == "render" {
            std::os::unix::fs::symlink("/dev/full", sandbox.path("full.gif")).unwrap();
        }
        sandbox.run(&arguments).code(1).stderr(full.clone());
    }
}

/// A policy that only looks at the pole solves the task and leaves the track later; one that looks at the cart too stays.
#[test]
fn another_time_limit_shows_a_cart_that_drifts_away() {
    let sandbox = Sandbox::new();
    let evaluate = |weights: [f32; 8], more: &[&str]| {
        let [_, bias, weight2, bias2] = FOLLOW_THE_POLE;
        write_foreign(&sandbox, &[("0.weight", &[2, 4], &weights), bias, weight2, bias2]);
        stdout_json(&sandbox.run(&[&["eval", "--json", FOREIGN], more].concat()).success())
    };
    let of = |cart: f32, speed: f32| [cart, speed, 1.0, 0.5, -cart, -speed, -1.0, -0.5];
    let long = ["--max-steps", "20000"];
    let short = evaluate(of(0.0, 0.0), &[]);
    assert_eq!((&short["max_steps"], &short["solved"]), (&json!(500), &json!(true)), "{short}");
    let drifting = evaluate(of(0.0, 0.0), &long);
    assert_eq!((&drifting["max_steps"], &drifting["solved"]), (&json!(20_000), &json!(true)));
    assert!(drifting["min"].as_f64().unwrap() < 20_000.0, "{drifting}");
    let staying = evaluate(of(0.05, 0.2), &long);
    assert_eq!(staying["min"], json!(20_000.0), "{staying}");
    assert_eq!(evaluate(of(0.05, 0.2), &["--max-steps", "400"])["solved"], json!(null), "not played to 500");
    assert_eq!(evaluate(of(0.05, 0.2), &["--episodes", "99"])["solved"], json!(null), "too few episodes");
    // Cut off after 50 steps every policy has -50, which is above the threshold of -100.
    let acrobot = ["eval", "--policy", "random", "--environment", "Acrobot-v1", "--max-steps", "50"];
    sandbox.run(&acrobot).success().stdout(predicates::str::contains("solved         open"));
    let text = sandbox.run(&["eval", FOREIGN, "--max-steps", "700"]).success();
    text.stdout(predicates::str::contains("at 700 ").and(predicates::str::contains("step 500")));
}

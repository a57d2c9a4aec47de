//! `train`: options that people know from elsewhere, what a run says, and the files that it leaves.

use crate::cli::{Sandbox, refusals};

refusals! {
    names_the_key_for_steps: [], ["train", "--steps", "20000"]
        => ["`--steps` is no option of `train`", " train --set budget.steps=20000\n"];
    names_the_key_for_steps_with_an_equals_sign: [], ["train", "--steps=20000"] => [" train --set budget.steps=20000\n"];
    names_the_keys_of_all_options_in_one_line: [],
        ["train", "--lr", "1e-3", "--out", "x", "--gamma=0.9", "--batch-size", "64"]
        => [" train --set optimizer.learning_rate=1e-3 --out x --set gamma=0.9 --set replay.batch_size=64\n"];
    names_the_key_of_a_study_too: [], ["study", "--episodes", "500", "--seeds", "0..3", "--out", "s"]
        => [" study --set budget.episodes=500 --seeds 0..3 --out s\n"];
    names_the_keys_for_a_constant_epsilon: [], ["train", "--epsilon", "0.1"]
        => ["--set exploration.initial=0.1 --set exploration.final=0.1"];
    tells_a_decay_per_episode_from_one_over_steps: [], ["train", "--epsilon-decay", "0.995", "--eps-decay", "8000"]
        => ["exploration.schedule=per_episode --set exploration.decay=0.995", "exploration.schedule=linear --set exploration.steps=8000"];
    makes_a_list_of_layers: [], ["train", "--hidden", "64", "64"] => ["--set 'network.hidden=[64,64]'"];
    takes_a_negative_value_along: [], ["train", "--lr", "-0.1"] => ["--set optimizer.learning_rate=-0.1"];
    asks_for_a_value_that_is_missing: [], ["train", "--lr", "--double"]
        => ["--set optimizer.learning_rate=VALUE --set double=true"];
    knows_every_key_as_an_option: [], ["train", "--replay.warmup_steps", "5", "--beta1", "0.8"]
        => ["--set replay.warmup_steps=5 --set optimizer.beta1=0.8"];
}

/// Every line that is given as advice is one that works, whatever the config.
#[test]
#[cfg(unix)]
fn the_line_to_type_is_accepted() {
    let configs =
        ["cartpole", "tutorial"].map(|name| format!("{}/configs/{name}.json", env!("CARGO_MANIFEST_DIR")));
    let options: &[&[&str]] = &[
        &["--steps", "20000", "--lr", "0.001", "--learning-rate", "0.001", "--gamma", "0.9"],
        &["--episodes", "200", "--discount", "0.9", "--batch-size", "64", "--buffer-size", "9999"],
        &["--epsilon", "0.1"],
        &["--epsilon-start", "0.9", "--epsilon-end", "0.01"],
        &["--epsilon-decay", "0.99", "--epsilon-min", "0.02"],
        &["--epsilon-decay", "5000", "--learning-starts", "500"],
        &["--hidden", "64,64", "--n-step", "3", "--warmup", "100", "--double", "--huber"],
        &["--hidden-size", "64", "--tau", "0.01", "--no-double"],
        &["--target-update", "500", "--max-grad-norm", "10", "--train-freq", "2", "--gradient-steps", "2"],
        &["--eval-freq", "500", "--eval-episodes", "5", "--save-freq", "1000", "--reward-scale", "0.1"],
        &["--env", "CartPole-v1", "--n_step", "2", "--LR", "0.1", "--loss", "mse"],
    ];
    for config in &configs {
        for options in options {
            let sandbox = Sandbox::new();
            let refused = sandbox.run(&[&["train", "--config", config], *options].concat()).code(2);
            let message = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
            let line = message.lines().nth(1).unwrap().replacen(" train ", " config show ", 1);
            let shown = std::process::Command::new("sh").args(["-c", &line]).output().unwrap();
            assert!(shown.status.success(), "{line}\n{}", String::from_utf8_lossy(&shown.stderr));
        }
    }
}

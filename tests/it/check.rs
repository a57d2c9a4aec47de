//! `check` and `explain`: other people's updates, with and without mistakes.

use std::collections::BTreeSet;
use std::fs;

use cartpole_dqn::check::{
    Batch, CHANGES, MISTAKES, Mistake, Moments, Number, OptimizerName, QuantityState, Reference, Results,
    Settings, Stage, Update, Variant, Verdict, check,
};
use cartpole_dqn::explain::explain;
use cartpole_dqn::nn::{Loss, Mlp};
use cartpole_dqn::rng::Rng;
use cartpole_dqn::trainer::Event;

use super::tasks::dqn;
use nalgebra::DMatrix;
use predicates::prelude::*;
use serde_json::Value;

use crate::cli::{Sandbox, TINY, sets};
use crate::{golden, members, numbers};

/// Rows of random numbers, a fifth of which end an episode.
pub fn random_batch(rng: &mut Rng, [size, inputs]: [usize; 2], gamma: f64) -> Batch {
    let mut observations = || DMatrix::from_fn(size, inputs, |_, _| rng.uniform(-2.0, 2.0));
    let (observations, next_observations) = (observations(), observations());
    Batch {
        observations,
        next_observations,
        actions: (0..size).map(|sample| sample % 3).collect(),
        rewards: (0..size).map(|_| rng.uniform(-2.0, 3.0)).collect(),
        terminated: (0..size).map(|sample| sample % 5 == 0).collect(),
        truncated: None,
        discounts: vec![gamma; size],
        weights: None,
    }
}

/// An update without results, in which every mistake of the catalogue can show.
fn update(settings: Settings, steps: u64, has_target: bool) -> Update {
    let mut rng = Rng::from_seed(5);
    let (sizes, size) = (vec![4, 12, 9, 3], 24);
    let mut network = |low: f64, high: f64| {
        let mut network = Mlp::zeros(sizes.clone());
        network.parameters_mut().fill_with(|| rng.uniform(low, high));
        network
    };
    let (online, target) = (network(-0.6, 0.6), network(-0.6, 0.6));
    let moments = match steps {
        0 => [Mlp::zeros(sizes.clone()), Mlp::zeros(sizes.clone())],
        _ => [network(-0.02, 0.02), network(0.0, 1e-3)],
    };
    let [first, second] = moments;
    let mut batch = random_batch(&mut rng, [size, 4], settings.gamma);
    batch.truncated = Some((0..size).map(|sample| sample % 7 == 1).collect());
    Update {
        before: None,
        settings,
        online,
        target: has_target.then_some(target),
        batch,
        adam: Moments { steps, first, second, largest: None },
        results: Results::default(),
        rounding_unit: f64::EPSILON / 2.0,
    }
}

/// Fills in what a variant gives of these quantities.
fn fill(update: &mut Update, variant: &Variant, stages: &[Stage]) {
    let (q, targets, loss, gradients, weights) = {
        let reference = Reference::new(update);
        let targets = reference.targets(variant);
        let loss = reference.loss(variant, &targets);
        let raw = reference.raw_gradients(variant, &targets, &loss, 0);
        let gradients = reference.changed(variant, raw);
        let weights = reference.weights(variant, &gradients, 0);
        (reference.q(variant), targets.values, loss.value.value, gradients, weights)
    };
    let network = |numbers: &[Number]| {
        let mut network = update.online.clone();
        network.parameters_mut().iter_mut().zip(numbers).for_each(|(to, from)| *to = from.value);
        network
    };
    let has = |stage| stages.contains(&stage);
    let q = DMatrix::from_iterator(24, 3, q.iter().map(|q| q.value));
    update.results = Results {
        q: has(Stage::Q).then_some(q),
        target: None,
        targets: has(Stage::Targets).then(|| targets.iter().map(|target| target.value).collect()),
        loss: has(Stage::Loss).then_some(loss),
        gradients: has(Stage::Gradients).then(|| network(&gradients)),
        online: has(Stage::Weights).then(|| network(&weights)),
    };
}

/// Settings under which a mistake is one.
fn settings_for(id: &str) -> Settings {
    Settings {
        gamma: 0.9,
        double: id.starts_with("double_exchanged") || id.starts_with("double_left"),
        loss: if id == "mse_for_huber" { Loss::Huber } else { Loss::Mse },
        max_gradient_norm: id.starts_with("gradient_not").then_some(0.3).or_else(|| {
            ["gradient_clipped_by_value", "gradient_clipped_by_tensor"].contains(&id).then_some(0.3)
        }),
        optimizer: match id {
            "adam" => OptimizerName::Sgd,
            "weight_decay_forgotten" => OptimizerName::AdamW,
            _ => OptimizerName::Adam,
        },
        amsgrad: id == "amsgrad_left_out",
        ..Settings::default()
    }
}

fn explanations(verdict: &Verdict) -> Vec<Vec<&'static str>> {
    verdict.explanations.iter().map(|found| found.iter().map(|one| one.mistake.id).collect()).collect()
}

/// The recordings of PyTorch, whose first step starts with a fresh Adam.
#[test]
fn golden_torch_updates_are_equal_in_all_four_quantities() {
    let recording = golden("torch_dqn_update.json");
    for case in members(&recording["cases"]) {
        let sizes: Vec<usize> = numbers(&case["sizes"]).iter().map(|&size| size as usize).collect();
        let network = |tensors: &Value| {
            let mut network: Mlp<f64> = Mlp::zeros(sizes.clone());
            for (index, pair) in sizes.windows(2).enumerate() {
                let weight = numbers(&tensors[format!("{}.weight", 2 * index)]);
                let bias = numbers(&tensors[format!("{}.bias", 2 * index)]);
                let weight = DMatrix::from_row_slice(pair[1], pair[0], &weight);
                let layer = network.layer_mut(index);
                layer[..pair[0] * pair[1]].copy_from_slice(weight.as_slice());
                layer[pair[0] * pair[1]..].copy_from_slice(&bias);
            }
            network
        };
        let step = &members(&case["steps"])[0];
        let number = |key: &str| case[key].as_f64().unwrap();
        let size = number("batch") as usize;
        let observations = |key: &str| DMatrix::from_row_slice(size, sizes[0], &numbers(&step[key]));
        let settings = Settings {
            gamma: number("gamma"),
            loss: serde_json::from_value(case["loss"].clone()).unwrap(),
            double: case["double"].as_bool().unwrap(),
            learning_rate: number("learning_rate"),
            ..Settings::default()
        };
        let fresh = Mlp::zeros(sizes.clone());
        let update = Update {
            settings,
            online: network(&case["online"]),
            target: Some(network(&case["target"])),
            batch: Batch {
                observations: observations("states"),
                actions: serde_json::from_value(step["actions"].clone()).unwrap(),
                rewards: numbers(&step["rewards"]),
                next_observations: observations("next_states"),
                terminated: serde_json::from_value(step["terminated"].clone()).unwrap(),
                truncated: None,
                discounts: vec![number("gamma"); size],
                weights: None,
            },
            adam: Moments { steps: 0, first: fresh.clone(), second: fresh, largest: None },
            before: None,
            results: Results {
                q: None,
                target: None,
                targets: Some(numbers(&step["targets"])),
                loss: step["loss"].as_f64(),
                gradients: Some(network(&step["gradients"])),
                online: Some(network(&step["online_after"])),
            },
            rounding_unit: f64::EPSILON / 2.0,
        };
        let verdict = check(&update);
        assert!(verdict.equal, "{sizes:?}: {verdict:?}");
        assert!(verdict.explanations.is_empty());
    }
}

#[test]
fn every_mistake_of_the_catalogue_is_named() {
    for mistake in Mistake::of_updates() {
        let steps = if mistake.id == "gradient_accumulated" { 1 } else { 20 };
        let has_target = mistake.id != "gradient_through_target";
        let mut update = update(settings_for(mistake.id), steps, has_target);
        let is_n_step = mistake.id.starts_with("discount_of_one") || mistake.id == "full_n_at_the_end";
        if is_n_step {
            update.batch.discounts =
                (0..24).map(|sample| 0.9_f64.powi(if sample % 7 == 1 { 2 } else { 3 })).collect();
        }
        update.batch.weights = (mistake.id == "weights_forgotten")
            .then(|| (0..24).map(|sample| 0.2 + 0.1 * f64::from(sample)).collect());
        update.adam.largest = (mistake.id == "amsgrad_left_out").then(|| {
            let mut largest = update.adam.second.clone();
            largest.parameters_mut().iter_mut().for_each(|v| *v *= 2.0);
            largest
        });
        let variant = mistake.on(&Variant::right(&update));
        assert_ne!(variant, Variant::right(&update), "{}", mistake.id);
        fill(&mut update, &variant, &Stage::ALL);
        if mistake.stage == Stage::Q {
            let q: Vec<f64> = Reference::new(&update).q(&variant).iter().map(|q| q.value).collect();
            update.results.q = Some(DMatrix::from_vec(24, 3, q));
        }
        let verdict = check(&update);
        assert!(explanations(&verdict).contains(&vec![mistake.id]), "{}: {verdict:?}", mistake.id);
        assert!(!verdict.equal);
        let state = |stage| verdict.quantities.iter().find(|judged| judged.name == stage).unwrap().state;
        assert_eq!(state(mistake.stage), QuantityState::Explained, "{}", mistake.id);
    }
}

#[test]
fn the_page_of_mistakes_has_each_mistake_of_the_program_once_with_all_its_texts_and_no_other() {
    let page = include_str!("../../docs/mistakes.md");
    assert_eq!(
        page.lines().filter(|line| line.starts_with("| `")).count(),
        MISTAKES.len(),
        "a row lacks a cell"
    );
    let of_page: BTreeSet<&str> = MISTAKES.iter().map(|mistake| mistake.id).collect();
    assert_eq!(of_page.len(), MISTAKES.len(), "a mistake is there twice");
    // What names a mistake asks the page for it; of what is on the page each is named somewhere.
    let files = [
        "mistakes",
        "batch",
        "verdict",
        "trace/ends",
        "trace/memory",
        "trace/exploration",
        "trace/target",
        "trace/updates",
    ];
    let read =
        |file| fs::read_to_string(format!("{}/src/check/{file}.rs", env!("CARGO_MANIFEST_DIR"))).unwrap();
    let program = files.map(read).concat();
    let unnamed: Vec<_> = of_page.iter().filter(|id| !program.contains(&format!("\"{id}\""))).collect();
    assert_eq!(unnamed, Vec::<&&str>::new());
    assert!(Mistake::of_updates().map(|mistake| mistake.id).eq(CHANGES.iter().map(|(id, ..)| *id)));
    for mistake in MISTAKES.iter() {
        let texts = [&mistake.what, &mistake.why, &mistake.mend];
        assert!(texts.iter().all(|text| text.len() > 2 && !text.contains("\\")), "{mistake:?}");
        // An open backtick would swallow the columns that follow.
        assert!(texts.iter().all(|text| text.matches('`').count() % 2 == 0), "{mistake:?}");
    }
    assert!(Mistake::named("absolute_error").unwrap().what.ends_with("the absolute error |δ|"));
    let printed = serde_json::to_value(Mistake::named("sum").unwrap()).unwrap();
    assert!(printed.as_object().unwrap().keys().eq(["id", "what", "why", "mend"]), "{printed}");
}

#[test]
fn a_mistake_is_named_from_the_weights_alone() {
    for id in ["terminal_bootstrapped", "every_pair", "gradient_of_all_actions", "sgd"] {
        let mistake = Mistake::named(id).unwrap();
        let mut update = update(settings_for(id), 20, true);
        let variant = mistake.on(&Variant::right(&update));
        fill(&mut update, &variant, &[Stage::Weights]);
        let verdict = check(&update);
        assert!(explanations(&verdict).contains(&vec![id]), "{id}: {verdict:?}");
        assert_eq!(verdict.quantities[0].state, QuantityState::Absent);
    }
}

#[test]
fn two_mistakes_are_both_named_in_different_quantities_and_in_the_same() {
    for ids in [
        ["discount_twice", "sum"],
        ["terminal_bootstrapped", "adam_uncorrected"],
        ["terminal_bootstrapped", "bootstrap_from_online"],
        ["sum", "huber_for_mse"],
        ["weight_decay", "step_count_behind"],
    ] {
        let mut update = update(settings_for(ids[0]), 20, true);
        let mistakes = ids.map(|id| Mistake::named(id).unwrap());
        let variant = mistakes[1].on(&mistakes[0].on(&Variant::right(&update)));
        fill(&mut update, &variant, &Stage::ALL);
        let verdict = check(&update);
        assert!(explanations(&verdict).contains(&ids.to_vec()), "{ids:?}: {verdict:?}");
    }
}

/// Somebody who prints the sum and learns from the mean.
#[test]
fn a_mistake_in_the_reported_number_alone_is_told_apart() {
    let mut update = update(settings_for("sum"), 20, true);
    let right = Variant::right(&update);
    fill(&mut update, &right, &Stage::ALL);
    update.results.loss = update.results.loss.map(|loss| loss * 24.0);
    let verdict = check(&update);
    assert_eq!(explanations(&verdict), [["sum"]]);
    assert!(verdict.explanations[0][0].reported_only);
    assert_eq!(verdict.quantities[2].state, QuantityState::Equal);
}

#[test]
fn numbers_that_no_known_mistake_gives_differ_and_what_follows_is_judged_from_them() {
    type Change<'a> = &'a dyn Fn(usize, f64, &Batch) -> f64;
    let changes: [Change<'_>; 3] = [
        &|i, y, batch| if batch.terminated[i] { y - 10.0 } else { y },
        &|i, y, batch| if batch.actions[i] == 1 { y * 0.7 } else { y },
        &|_, y, _| y * 0.7,
    ];
    for change in changes {
        let mut update = update(settings_for(""), 20, true);
        let right = Variant::right(&update);
        fill(&mut update, &right, &[Stage::Targets]);
        let targets = update.results.targets.take().unwrap();
        let changed = targets.iter().enumerate().map(|(i, &target)| change(i, target, &update.batch));
        let changed: Vec<f64> = changed.collect();
        let loss = {
            let reference = Reference::new(&update);
            let mut targets = reference.targets(&right);
            targets.values = changed.iter().map(|&target| Number::exact(target)).collect();
            reference.loss(&right, &targets).value.value
        };
        (update.results.targets, update.results.loss) = (Some(changed), Some(loss));
        let verdict = check(&update);
        assert!(verdict.explanations.is_empty() && !verdict.equal, "{verdict:?}");
        let states: Vec<_> = verdict.quantities.iter().map(|quantity| quantity.state).collect();
        assert_eq!(states[..2], [QuantityState::Different, QuantityState::Equal], "{verdict:?}");
    }
}

#[test]
fn an_update_that_cannot_show_a_mistake_says_so() {
    let mut update = update(settings_for(""), 20, true);
    update.batch.terminated.fill(false);
    update.batch.truncated = None;
    let right = Variant::right(&update);
    fill(&mut update, &right, &Stage::ALL);
    let verdict = check(&update);
    assert!(verdict.equal);
    for name in ["terminal bootstrapped", "truncation not bootstrapped", "terminal reward lost"] {
        assert!(verdict.not_visible.iter().any(|hidden| hidden == name), "{name}: {:?}", verdict.not_visible);
    }
    assert!(!verdict.not_visible.iter().any(|hidden| hidden == "sum"));
}

#[test]
fn a_norm_is_shortened_rightly_in_both_ways_and_the_verdict_says_which_one_it_is() {
    for (margin, name) in [(1e-6, "PyTorch"), (0.0, "Optax")] {
        let settings = Settings { max_gradient_norm: Some(0.3), ..settings_for("") };
        for stages in [&Stage::ALL[..], &[Stage::Gradients]] {
            let mut update = update(settings, 20, true);
            let variant = Variant { norm_margin: Some(margin), ..Variant::right(&update) };
            fill(&mut update, &variant, stages);
            let verdict = check(&update);
            assert!(verdict.equal, "{name}: {verdict:?}");
            assert!(verdict.norm_clipping.is_some_and(|form| form.contains(name)), "{verdict:?}");
            // In f32 the two are the same numbers.
            update.rounding_unit = f64::from(f32::EPSILON) / 2.0;
            let verdict = check(&update);
            assert!(verdict.equal && verdict.norm_clipping.is_none(), "{verdict:?}");
        }
    }
}

/// Layers and a batch near the limits, and results that nothing explains: the whole catalogue is tried, or named.
#[test]
fn a_large_update_that_nothing_explains_says_what_was_not_tried() {
    let settings = Settings { max_gradient_norm: Some(0.3), ..settings_for("") };
    let mut rng = Rng::from_seed(7);
    let mut update = update(settings, 20, true);
    let (sizes, size) = (vec![4, 64, 64, 3], 1 << 13);
    let mut network = |high: f64| {
        let mut network = Mlp::zeros(sizes.clone());
        network.parameters_mut().fill_with(|| rng.uniform(0.0, high));
        network
    };
    (update.online, update.target) = (network(0.2), Some(network(0.2)));
    (update.adam.first, update.adam.second) = (network(0.1), network(0.1));
    let results = Results { gradients: Some(network(0.1)), online: Some(network(0.3)), ..Results::default() };
    let batch = &mut update.batch;
    batch.observations = DMatrix::from_fn(size, 4, |_, _| rng.uniform(-2.0, 2.0));
    batch.next_observations = DMatrix::from_fn(size, 4, |_, _| rng.uniform(-2.0, 2.0));
    batch.actions = (0..size).map(|sample| sample % 3).collect();
    batch.rewards = (0..size).map(|_| rng.uniform(-2.0, 3.0)).collect();
    batch.terminated = vec![false; size];
    batch.truncated = None;
    batch.discounts = vec![0.9; size];
    update.results = results;
    let verdict = check(&update);
    let states: Vec<_> = verdict.quantities.iter().map(|quantity| quantity.state).collect();
    assert_eq!(
        states,
        [QuantityState::Absent, QuantityState::Absent, QuantityState::Different, QuantityState::Different]
    );
    assert!(verdict.pairs_left_out && verdict.explanations.is_empty(), "{verdict:?}");
}

/// Every kind of config that changes the update.
const CONFIGS: [&[&str]; 7] = [
    &[],
    &["n_step=5", "double=true", "loss=huber"],
    &[
        "target={\"kind\":\"hard\",\"every_steps\":20}",
        "policy_weights=online",
        "optimizer.max_gradient_norm=0.01",
    ],
    &["target={\"kind\":\"soft\",\"tau\":0.01}", "learn.updates=3"],
    &[
        "target={\"kind\":\"none\"}",
        "policy_weights=online",
        "observation_divisors=[2.4,3,0.2,3]",
        "reward_scale=0.01",
    ],
    &["replay.update=per_sample", "truncation_is_terminal=true"],
    &["optimizer.schedule.steps=150", "optimizer.epsilon=1e-7", "network.init=he_uniform"],
];

#[test]
fn every_update_that_explain_writes_is_equal() {
    for config in CONFIGS {
        let sandbox = Sandbox::new();
        let options = [sets(TINY), sets(config)].concat();
        for update in ["1", "2", "90"] {
            let explain = ["explain", "--update", update, "--out", "update.safetensors"];
            let assert = sandbox.run(&[&explain[..], &options].concat()).success();
            let text = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
            assert!(text.lines().all(|line| line.chars().count() <= 80), "{config:?}\n{text}");
            let assert = sandbox.run(&["check", "update.safetensors", "--json"]);
            let verdict: Value = serde_json::from_slice(&assert.get_output().stdout).unwrap();
            assert!(verdict["equal"].as_bool().unwrap(), "{config:?} {update}: {verdict}");
            assert.code(0);
        }
    }
}

#[test]
fn the_update_that_explain_shows_is_the_one_of_the_training() {
    let set = |settings: &[&str]| {
        let sets: Vec<String> = [TINY, settings].concat().iter().map(ToString::to_string).collect();
        super::plain(&sets)
    };
    for (settings, updates) in [(&["learn.updates=3"][..], 60), (&["replay.update=per_sample"], 160)] {
        let config = set(settings);
        let mut trainer = config.make_trainer().unwrap();
        while dqn(&trainer).adam.steps < updates {
            trainer.step(&mut Vec::<Event>::new()).unwrap();
        }
        let explained = explain(&config, updates).unwrap();
        assert_eq!(explained.after.online.mlp, dqn(&trainer).online.mlp, "{settings:?}");
        assert_eq!(explained.after.adam, dqn(&trainer).adam);
        assert_eq!(explained.env_steps, trainer.progress().env_steps);
    }
}

#[test]
fn explain_says_which_is_the_last_update() {
    let sandbox = Sandbox::new();
    let explain = [&["explain", "--update", "1000"][..], &sets(TINY)].concat();
    sandbox
        .run(&explain)
        .code(2)
        .stdout("")
        .stderr(predicate::str::contains("the run ends after update 151"));
    sandbox.run(&["explain", "--update", "0"]).code(2).stdout("");
    // Before anything is trained.
    sandbox.write("notes.txt", "mine");
    let explain = ["explain", "--update", "60000000", "--out", "notes.txt"];
    sandbox.run(&explain).code(2).stderr(predicate::str::contains("is not an update"));
    assert_eq!(sandbox.read("notes.txt"), "mine");
}

#[test]
fn check_explains_within_80_columns_and_says_by_its_exit_code_whether_something_differs() {
    let sandbox = Sandbox::new();
    let explain = ["explain", "--update", "90", "--out", "right.safetensors"];
    sandbox.run(&[&explain[..], &sets(TINY)].concat()).success();
    let equal = sandbox.run(&["check", "right.safetensors"]).code(0).stderr("");
    let text = String::from_utf8(equal.get_output().stdout.clone()).unwrap();
    assert_eq!(text.matches("equal (largest relative difference").count(), 4, "{text}");

    // The same numbers under another discount.
    let bytes = std::fs::read(sandbox.path("right.safetensors")).unwrap();
    let wrong = replaced(&bytes, br#"\"loss\":\"mse\""#, br#"\"loss\":\"huber\""#);
    sandbox.write("wrong.safetensors", wrong);
    let different = sandbox.run(&["check", "wrong.safetensors"]).code(1);
    let output = different.get_output();
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    assert!(text.contains("the loss is the square, the settings say"), "{text}");
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("explains what differs"));
}

/// A safetensors file with a part of its JSON replaced.
fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let end = 8 + usize::try_from(u64::from_le_bytes(bytes[..8].try_into().unwrap())).unwrap();
    let place = bytes.windows(from.len()).position(|window| window == from).unwrap();
    let header = [&bytes[8..place], to, &bytes[place + from.len()..end]].concat();
    [&(header.len() as u64).to_le_bytes()[..], &header, &bytes[end..]].concat()
}

#[test]
fn an_update_can_come_from_standard_input_and_a_policy_is_none() {
    let sandbox = Sandbox::with_run();
    let explain = ["explain", "--update", "90", "--out", "right.safetensors"];
    sandbox.run(&[&explain[..], &sets(TINY)].concat()).success();
    let right = std::fs::read(sandbox.path("right.safetensors")).unwrap();
    for place in ["-", "/dev/stdin"] {
        let sent = sandbox.assert(sandbox.command(&["check", place]).write_stdin(right.clone())).success();
        assert!(String::from_utf8_lossy(&sent.get_output().stdout).contains("file        standard input"));
        sandbox.assert(sandbox.command(&["check", place]).write_stdin(&right[..99])).code(2);
    }
    for policy in ["run/checkpoints/best.safetensors", "run/checkpoints/last.safetensors"] {
        sandbox.refuses(&["check", policy], &["holds a policy", "docs/check.md"]);
    }
}

#[test]
fn what_is_wrong_with_a_file_is_named_with_what_is_expected() {
    let sandbox = Sandbox::new();
    let explain = ["explain", "--update", "90", "--out", "right.safetensors"];
    sandbox.run(&[&explain[..], &sets(TINY)].concat()).success();
    let right = std::fs::read(sandbox.path("right.safetensors")).unwrap();
    let refused = |bytes: Vec<u8>, parts: &[&str]| {
        sandbox.write("wrong.safetensors", bytes);
        let assert = sandbox.run(&["check", "wrong.safetensors"]).code(2).stdout("");
        let message = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    };
    let changed = |from: &str, to: &str| replaced(&right, from.as_bytes(), to.as_bytes());
    refused(changed("batch.rewards", "batch.reward"), &["no tensor `batch.rewards`", "[8]"]);
    refused(
        changed("online.0.weight", "online.1.weight"),
        &["no tensor `online.0.weight`", "[outputs, inputs]"],
    );
    refused(changed("adam.steps", "adam.step"), &["no tensor", "adam"]);
    refused(changed("result.loss", "result.lost"), &["`result.lost`", "means nothing"]);
    refused(changed(r#"\"gamma\""#, r#"\"gama\""#), &["unknown field `gama`", "`gamma`"]);
    refused(changed(r#"\"gamma\":0.99"#, r#"\"gamma\":1.99"#), &["`gamma` is 1.99", "from 0 to 1"]);
    refused(changed(r#"\"mse\""#, r#"\"mae\""#), &["`mae`", "`mse`"]);
    refused(changed(r#""shape":[8,4]"#, r#""shape":[4,8]"#), &["[4, 8]", "expected"]);
    refused(
        changed(r#""dtype":"U64","shape":[1]"#, r#""dtype":"F64","shape":[1]"#),
        &["adam.steps", "integer"],
    );
    refused(right[..right.len() / 2].to_vec(), &["cut off or damaged"]);
    refused(b"{}".to_vec(), &["not a safetensors file"]);
    sandbox.run(&["check", "nowhere.safetensors"]).code(2).stderr(predicate::str::contains("cannot be read"));

    let set: Vec<String> = TINY.iter().map(ToString::to_string).collect();
    let explained = cartpole_dqn::explain::explain(&super::plain(&set), 90).unwrap();
    for (name, shape, values, expected) in [
        (
            "batch.rewards",
            &[8][..],
            &[f32::INFINITY; 8][..],
            &["`batch.rewards` holds inf", "a finite number"][..],
        ),
        ("online.0.bias", &[8], &[f32::NAN; 8], &["`online.0.bias` holds NaN", "a finite number"]),
        ("batch.observations", &[0, 4], &[], &["F32 [0, 4]", "a batch of at least 1"]),
        ("batch.actions", &[8], &[2.0; 8], &["holds 2", "an action from 0 to 1"]),
        ("batch.terminated", &[8], &[0.5; 8], &["holds 0.5", "0 or 1"]),
        ("adam.v.0.bias", &[8], &[-1.0; 8], &["holds -1", "at least 0"]),
        ("adam.steps", &[1], &[1.5], &["holds 1.5", "one integer"]),
    ] {
        let mut file = explained.tensors();
        file.put(name, shape, values);
        refused(file.to_safetensors(Some(explained.settings().metadata())).unwrap(), expected);
    }
}

/// A safetensors file without data, of these entries of its header.
fn header_alone(entries: impl Iterator<Item = String>) -> Vec<u8> {
    let header = format!("{{{}}}", entries.collect::<Vec<_>>().join(","));
    [&(header.len() as u64).to_le_bytes()[..], header.as_bytes()].concat()
}

#[test]
fn a_message_has_a_limit_whatever_stands_in_the_file() {
    let sandbox = Sandbox::new();
    let long = "x".repeat(5_000_000);
    let entry = |name: &str| format!(r#""{name}":{{"dtype":"F32","shape":[0],"data_offsets":[0,0]}}"#);
    sandbox.write("name.safetensors", header_alone([entry(&long)].into_iter()));
    sandbox.write("type.safetensors", header_alone([format!(r#""a":{{"dtype":"{long}"}}"#)].into_iter()));
    sandbox.write("key.json", format!(r#"{{"{long}": 1}}"#));
    sandbox.write("value.json", format!(r#"{{"agent": "{long}"}}"#));
    for arguments in [
        ["check", "name.safetensors"],
        ["check", "type.safetensors"],
        ["eval", "name.safetensors"],
        ["eval", "type.safetensors"],
        ["inspect", "type.safetensors"],
        ["train", "--config=key.json"],
        ["train", "--config=value.json"],
        ["study", "--config=key.json"],
    ] {
        let assert = sandbox.run(&arguments).code(2);
        let message = &assert.get_output().stderr;
        assert!(message.len() < 20_000, "{arguments:?}: {} bytes", message.len());
        assert!(message.starts_with(b"error: "), "{arguments:?}");
    }
}

#[test]
fn a_file_of_very_many_tensors_is_refused_before_they_are_taken_apart() {
    let sandbox = Sandbox::new();
    let entry = |i: usize| format!(r#""{i}.weight":{{"dtype":"F32","shape":[0],"data_offsets":[0,0]}}"#);
    sandbox.write("many.safetensors", header_alone((0..400_000).map(entry)));
    for arguments in
        [["eval", "many.safetensors"], ["inspect", "many.safetensors"], ["check", "many.safetensors"]]
    {
        sandbox.refuses(&arguments, &["more than 4096 tensors"]);
    }
    let mut eval = sandbox.command(&["eval", "-"]);
    eval.pipe_stdin(sandbox.path("many.safetensors")).unwrap();
    sandbox.assert(&mut eval).code(2).stderr(predicate::str::contains("more than 4096 tensors"));
}

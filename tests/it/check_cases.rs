//! `check` on updates of other people's programs, with what they got wrong, and on right ones that the settings describe.

use std::collections::HashMap;

use cartpole_dqn::check::{
    Batch, Moments, OptimizerName, QuantityState, Reference, Results, Settings, Update, Variant, Verdict,
    check,
};
use cartpole_dqn::env::Start;
use cartpole_dqn::env::catalogue::EnvironmentId;
use cartpole_dqn::nn::{Loss, Mlp};
use cartpole_dqn::rng::Rng;
use nalgebra::DMatrix;
use safetensors::SafeTensors;
use serde_json::Value;

use crate::check::random_batch;

/// Everything that is named: explanations of the numbers, and what the batch shows.
fn named(verdict: &Verdict) -> Vec<&'static str> {
    let explained = verdict.explanations.iter().flatten().map(|explained| explained.mistake.id);
    explained.chain(verdict.batch.mistakes.iter().map(|found| found.mistake.id)).collect()
}

/// A case of tests/data/README.md under other settings, without some tensors and with others.
fn case(name: &str, settings: &str, more: &[(&str, &str)]) -> Update {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/check_cases.safetensors");
    let bytes = std::fs::read(path).unwrap();
    let (_, metadata) = SafeTensors::read_metadata(&bytes).unwrap();
    let cases: Value = serde_json::from_str(&metadata.metadata().as_ref().unwrap()["cases"]).unwrap();
    let all = SafeTensors::deserialize(&bytes).unwrap();
    let case = &cases[name];
    let names = case["tensors"].as_object().unwrap();
    let mut tensors: HashMap<String, _> =
        names.iter().map(|(name, id)| (name.clone(), all.tensor(id.as_str().unwrap()).unwrap())).collect();
    for (to, from) in more {
        let copied: Vec<_> = tensors
            .iter()
            .filter_map(|(name, view)| Some((format!("{to}{}", name.strip_prefix(from)?), view.clone())))
            .collect();
        tensors.extend(copied);
    }
    let settings = if settings.is_empty() { case["settings"].as_str().unwrap() } else { settings };
    let metadata = HashMap::from([("settings".to_owned(), settings.to_owned())]);
    let bytes = safetensors::serialize(tensors, Some(metadata)).unwrap();
    Update::from_bytes(&bytes).unwrap()
}

#[test]
fn every_case_is_judged_as_its_table_says() {
    let named_as = [
        ("int_observations", "observations_rounded"),
        ("always_action_0", "stored_action_is_another"),
        ("net_out_softmax_hidden_relu", "output_softmax"),
        ("net_out_linear_hidden_tanh", "hidden_tanh"),
        ("clip_value_0.1", "gradient_clipped_by_value"),
        ("smooth_l1_beta_half", "smooth_l1_beta"),
        ("targets_BxB", "targets_of_every_pair"),
        ("nan_loss", "not_finite"),
        ("one_network_and_no_detach", "gradient_through_target"),
        ("nstep_full_n_at_truncation", "full_n_at_the_end"),
        ("full_target_others_of_target_net", "full_target_of_target_network"),
        ("obs_and_next_obs_swapped_in_update", "observations_exchanged"),
        ("target_loaded_into_online_after", "online_overwritten_by_target"),
        ("momentum_sgd", "sgd_with_momentum"),
    ];
    for (name, id) in named_as {
        let verdict = check(&case(name, "", &[]));
        assert_eq!(named(&verdict), [id], "{name}: {verdict:?}");
        assert!(!verdict.equal);
        let open = verdict.quantities.iter().find(|judged| judged.state == QuantityState::Different);
        assert!(open.is_none(), "{name}: {open:?}");
    }
    for (name, settings) in [
        ("momentum_sgd", r#"{"optimizer": "sgd", "momentum": 0.9}"#),
        ("clip_value_0.1", r#"{"clip_value": 0.1}"#),
        ("smooth_l1_beta_half", r#"{"loss": "huber", "huber_delta": 0.5}"#),
    ] {
        let verdict = check(&case(name, settings, &[]));
        assert!(verdict.equal && named(&verdict).is_empty(), "{name}: {verdict:?}");
    }
}

#[test]
fn what_one_update_cannot_prove_is_a_fact_or_a_possibility() {
    let equal = |name: &str, fact: &str| {
        let verdict = check(&case(name, "", &[]));
        assert!(verdict.equal && named(&verdict).is_empty(), "{name}: {verdict:?}");
        assert!(
            verdict.facts.iter().chain(&verdict.not_visible).any(|said| said.contains(fact)),
            "{name}: {verdict:?}"
        );
    };
    equal("net_out_relu_hidden_relu", "output relu");
    equal("optimizer_recreated_each_step", "Adam is at its first step");
    equal("target_is_same_object", "equals your online network");
    let unexplained = |name: &str, said: &str| {
        let verdict = check(&case(name, "", &[]));
        assert!(!verdict.equal && named(&verdict).is_empty(), "{name}: {verdict:?}");
        let common = verdict.quantities.iter().filter_map(|judged| judged.common.as_ref());
        assert!(common.chain(&verdict.unseen).any(|text| text.contains(said)), "{name}: {verdict:?}");
    };
    unexplained("adam_amsgrad", "amsgrad");
    unexplained("zero_grad_missing", "before.gradients");
    unexplained("terminal_minus10_incl_timelimit", "terminated or were truncated; yours is -10 in each");
}

#[test]
fn a_gradient_that_was_there_before_is_named_where_the_file_has_it() {
    let mut update = case("zero_grad_missing", "", &[]);
    let right = case("adam_amsgrad", "", &[]);
    let [sum, own] = [&update, &right].map(|update| update.results.gradients.clone().unwrap());
    let mut before = sum.clone();
    before.parameters_mut().iter_mut().zip(own.parameters()).for_each(|(sum, own)| *sum -= own);
    update.before = Some(before);
    assert_eq!(named(&check(&update)), ["gradient_accumulated"]);
}

#[test]
fn q_values_show_the_output_and_the_network_that_was_asked() {
    let right = case("adam_amsgrad", "", &[]);
    let (rows, q) = (64, Reference::new(&right).q(&Variant::right(&right)));
    let q = DMatrix::from_iterator(rows, 2, q.iter().map(|q| q.value));
    let judged = |q: DMatrix<f64>| {
        let mut update = right.clone();
        update.results = Results { q: Some(q), targets: right.results.targets.clone(), ..Results::default() };
        named(&check(&update))
    };
    let none: [&str; 0] = [];
    assert_eq!(judged(q.clone()), none);
    // A dueling head whose mean is over the batch: a number for each row, which sum to 0.
    let shift = |row: usize| (row as f64 * 0.37).sin();
    let mean = (0..rows).map(shift).sum::<f64>() / rows as f64;
    let dueling = DMatrix::from_fn(rows, 2, |row, action| q[(row, action)] + shift(row) - mean);
    assert_eq!(judged(dueling), ["dueling_mean_over_batch"]);
    assert_eq!(judged(q.map(|q| 0.9 * q)), ["another_network"]);
}

#[test]
fn what_became_of_the_target_network_is_told() {
    let update = case("adam_amsgrad", "", &[("result.target.", "target.")]);
    let said = |verdict: &Verdict, part: &str| verdict.facts.iter().any(|fact| fact.contains(part));
    assert!(said(&check(&update), "stays as it is"));
    let moved = |tau: f64| {
        let mut update = update.clone();
        let online = update.results.online.clone().unwrap();
        let after = update.results.target.as_mut().unwrap();
        after
            .parameters_mut()
            .iter_mut()
            .zip(online.parameters())
            .for_each(|(to, from)| *to += tau * (from - *to));
        check(&update)
    };
    assert!(said(&moved(0.005), "moves by 0.005"));
    assert!(said(&moved(1.0), "is copied"));
    assert!(named(&moved(0.995)).contains(&"tau_reversed"));
    let same = check(&case("target_is_same_object", "", &[("result.target.", "result.online.")]));
    assert_eq!(named(&same), ["target_is_online"]);
}

/// An update of random numbers whose gradients are known, its steps yet to be made.
fn before_the_step(settings: Settings, rounding_unit: f64) -> Update {
    let mut rng = Rng::from_seed(11);
    let (sizes, size) = (vec![5, 16, 3], 32);
    let mut network = |low: f64, high: f64| {
        let mut network = Mlp::zeros(sizes.clone());
        network.parameters_mut().fill_with(|| rng.uniform(low, high));
        network
    };
    let (online, target) = (network(-0.6, 0.6), network(-0.6, 0.6));
    let largest = Some(network(0.0, 2e-3));
    let adam = Moments { steps: 30, first: network(-0.02, 0.02), second: network(0.0, 1e-3), largest };
    let mut batch = random_batch(&mut rng, [size, 5], settings.gamma);
    batch.weights = Some((0..size).map(|_| rng.uniform(0.1, 1.0)).collect());
    let results = Results::default();
    Update { settings, online, target: Some(target), batch, adam, before: None, results, rounding_unit }
}

/// An optimiser's step as its documentation has it, every operation rounded.
fn stepped(update: &Update, gradient: &[f64], round: impl Fn(f64) -> f64) -> Vec<f64> {
    let Settings { optimizer, learning_rate: rate, beta1, beta2, epsilon, momentum, alpha, .. } =
        update.settings;
    let (t, decay) = (update.adam.steps as i32 + 1, update.settings.weight_decay.unwrap_or(0.0));
    let weights = update.online.parameters();
    let step = |i: usize| {
        let (mut w, mut g) = (round(weights[i]), round(gradient[i]));
        let (m, v) = (round(update.adam.first.parameters()[i]), round(update.adam.second.parameters()[i]));
        match optimizer {
            OptimizerName::AdamW => w = round(w * round(1.0 - rate * decay)),
            _ => g = round(g + round(decay * w)),
        }
        let step = match optimizer {
            OptimizerName::Adam | OptimizerName::AdamW => {
                let m = round(round(beta1 * m) + round((1.0 - beta1) * g));
                let mut v = round(round(beta2 * v) + round((1.0 - beta2) * round(g * g)));
                if update.settings.amsgrad {
                    v = v.max(round(update.adam.largest.as_ref().unwrap().parameters()[i]));
                }
                let denominator = round(round(v.sqrt() / (1.0 - beta2.powi(t)).sqrt()) + epsilon);
                round(round(m / (1.0 - beta1.powi(t))) / denominator)
            }
            OptimizerName::RmsProp => {
                let v = round(round(alpha * v) + round((1.0 - alpha) * round(g * g)));
                round(g / round(round(v.sqrt()) + epsilon))
            }
            OptimizerName::Sgd => round(round(momentum * m) + g),
        };
        round(w - round(rate * step))
    };
    (0..weights.len()).map(step).collect()
}

#[test]
fn right_updates_of_every_optimiser_and_setting_are_equal() {
    let base = Settings { learning_rate: 3e-3, gamma: 0.9, ..Settings::default() };
    let adamw = Settings { optimizer: OptimizerName::AdamW, weight_decay: Some(0.01), ..base };
    let sgd = Settings { optimizer: OptimizerName::Sgd, ..base };
    let all = [
        base,
        Settings { weight_decay: Some(1e-3), ..base },
        adamw,
        Settings { amsgrad: true, ..adamw },
        Settings { amsgrad: true, loss: Loss::Huber, ..base },
        Settings { optimizer: OptimizerName::RmsProp, alpha: 0.95, ..base },
        sgd,
        Settings { momentum: 0.9, weight_decay: Some(1e-2), ..sgd },
        Settings { loss: Loss::Huber, huber_delta: 0.5, max_gradient_norm: Some(0.1), ..base },
        Settings { clip_value: Some(0.02), double: true, ..base },
    ];
    for settings in all {
        for (unit, margin) in [(f64::EPSILON / 2.0, 1e-6), (f64::from(f32::EPSILON) / 2.0, 0.0)] {
            let is_single = unit > 1e-10;
            let round = |x: f64| if is_single { f64::from(x as f32) } else { x };
            let mut update = before_the_step(settings, unit);
            update.online.parameters_mut().iter_mut().for_each(|weight| *weight = round(*weight));
            let variant = Variant { norm_margin: Some(margin), ..Variant::right(&update) };
            let (q, targets, loss, gradients) = {
                let reference = Reference::new(&update);
                let targets = reference.targets(&variant);
                let loss = reference.loss(&variant, &targets);
                let raw = reference.raw_gradients(&variant, &targets, &loss, 0);
                (reference.q(&variant), targets.values, loss.value.value, reference.changed(&variant, raw))
            };
            let gradients: Vec<f64> = gradients.iter().map(|gradient| round(gradient.value)).collect();
            let network = |values: &[f64]| {
                let mut network = update.online.clone();
                network.parameters_mut().copy_from_slice(values);
                network
            };
            let results = Results {
                q: Some(DMatrix::from_iterator(32, 3, q.iter().map(|q| round(q.value)))),
                targets: Some(targets.iter().map(|target| round(target.value)).collect()),
                loss: Some(round(loss)),
                online: Some(network(&stepped(&update, &gradients, round))),
                gradients: Some(network(&gradients)),
                target: update.target.clone(),
            };
            update.results = results;
            let verdict = check(&update);
            assert!(verdict.equal && named(&verdict).is_empty(), "{settings:?} {unit}: {verdict:?}");
        }
    }
}

/// (s, a, r, s′, terminated, truncated)
type Row = (Vec<f64>, usize, f64, Vec<f64>, bool, bool);

/// Rows of a task under a limit of 40 steps.
fn rows(id: EnvironmentId, count: usize) -> Vec<Row> {
    rows_within(id, count, 40)
}

fn rows_within(id: EnvironmentId, count: usize, limit: u32) -> Vec<Row> {
    let mut rng = Rng::from_seed(3);
    let mut environment = id.make(limit).unwrap();
    let spec = environment.spec().clone();
    let mut seen = vec![0.0_f32; spec.observation_size];
    environment.reset(Start::Seed(1), &mut seen).unwrap();
    let wide = |seen: &[f32]| seen.iter().map(|&x| f64::from(x)).collect::<Vec<_>>();
    let mut rows = Vec::new();
    while rows.len() < count {
        let s = wide(&seen);
        // Balanced now and then, so that some episodes reach the limit.
        let is_random = rng.uniform(0.0, 1.0) < 0.5 || spec.num_actions > 2;
        let action = if is_random {
            rng.uniform(0.0, spec.num_actions as f64) as usize
        } else {
            usize::from(3.0 * s[2] + s[3] > 0.0)
        };
        let outcome = environment.step(action, &mut seen).unwrap();
        rows.push((s, action, outcome.reward, wide(&seen), outcome.terminated, outcome.truncated));
        if outcome.ended() {
            environment.reset(Start::Stream(&mut rng), &mut seen).unwrap();
        }
    }
    rows
}

fn judged(id: EnvironmentId, rows: &[Row], has_truncated: bool) -> (Vec<&'static str>, Vec<String>) {
    judged_with(Settings::default(), id, rows, has_truncated)
}

fn judged_with(
    settings: Settings, id: EnvironmentId, rows: &[Row], has_truncated: bool,
) -> (Vec<&'static str>, Vec<String>) {
    judged_with_discounts(settings, id, rows, has_truncated, vec![0.99; rows.len()])
}

fn judged_with_discounts(
    settings: Settings, id: EnvironmentId, rows: &[Row], has_truncated: bool, discounts: Vec<f64>,
) -> (Vec<&'static str>, Vec<String>) {
    let size = rows.len();
    let spec = id.spec();
    let column = |of: &dyn Fn(&Row) -> Vec<f64>| {
        let values: Vec<f64> = rows.iter().flat_map(of).collect();
        DMatrix::from_row_slice(size, spec.observation_size, &values)
    };
    let mut online = Mlp::zeros(vec![spec.observation_size, 8, spec.num_actions]);
    let mut rng = Rng::from_seed(4);
    online.parameters_mut().fill_with(|| rng.uniform(-0.5, 0.5));
    let fresh = Mlp::zeros(online.sizes().to_vec());
    let mut update = Update {
        settings,
        batch: Batch {
            observations: column(&|row| row.0.clone()),
            next_observations: column(&|row| row.3.clone()),
            actions: rows.iter().map(|row| row.1).collect(),
            rewards: rows.iter().map(|row| row.2).collect(),
            terminated: rows.iter().map(|row| row.4).collect(),
            truncated: has_truncated.then(|| rows.iter().map(|row| row.5).collect()),
            discounts,
            weights: None,
        },
        adam: Moments { steps: 0, first: fresh.clone(), second: fresh, largest: None },
        before: None,
        results: Results::default(),
        rounding_unit: f64::from(f32::EPSILON) / 2.0,
        target: None,
        online,
    };
    let targets = Reference::new(&update).targets(&Variant::right(&update)).values;
    update.results.targets = Some(targets.iter().map(|target| target.value).collect());
    let verdict = check(&update);
    assert_eq!(verdict.quantities[0].state, QuantityState::Equal);
    assert_eq!(verdict.equal, verdict.batch.mistakes.is_empty());
    (named(&verdict), verdict.batch.facts)
}

const TASKS: [EnvironmentId; 3] =
    [EnvironmentId::CartPoleV1, EnvironmentId::AcrobotV1, EnvironmentId::MountainCarV0];
const NOTHING: [&str; 0] = [];

#[test]
fn right_rows_raise_no_alarm_whatever_somebody_chose() {
    for id in TASKS {
        let right = rows(id, 400);
        assert_eq!(judged(id, &right, true).0, NOTHING, "{id:?}");
        assert!(judged(id, &right, false).1[0].contains("all 400 rows"), "{id:?}");
        let mut scaled = right.clone();
        for row in &mut scaled {
            row.0.iter_mut().chain(&mut row.3).for_each(|x| *x *= 0.37);
            row.2 *= 0.1;
        }
        assert_eq!(judged(id, &scaled, true).0, NOTHING, "{id:?}");
        let named = Settings { environment: Some(id), ..Settings::default() };
        assert_eq!(judged_with(named, id, &scaled, true).0, NOTHING, "{id:?}");
        // An end of somebody's own, which all rows behind a threshold have.
        let mut ended = right.clone();
        let mut positions: Vec<f64> = right.iter().map(|row| row.3[0]).collect();
        positions.sort_by(f64::total_cmp);
        let threshold = positions[360];
        ended.iter_mut().for_each(|row| (row.4, row.5) = (row.4 || row.3[0] > threshold, false));
        assert!(ended.iter().zip(&right).any(|(ended, right)| ended.4 != right.4), "{id:?}");
        for settings in [Settings::default(), Settings { environment: Some(id), ..Settings::default() }] {
            assert_eq!(judged_with(settings, id, &ended, true).0, NOTHING, "{id:?}");
        }
        let mut renumbered = right.clone();
        let actions = id.spec().num_actions;
        renumbered.iter_mut().for_each(|row| row.1 = actions - 1 - row.1);
        assert_eq!(judged(id, &renumbered, true).0, NOTHING, "{id:?}");
        let mut punished = right.clone();
        punished.iter_mut().for_each(|row| row.2 = if row.4 { -10.0 } else { row.2 });
        assert_eq!(judged(id, &punished, true).0, NOTHING, "{id:?}");
        // PyTorch's tutorial stores no s′ of ends.
        let mut blank = right.clone();
        blank.iter_mut().filter(|row| row.4).for_each(|row| row.3.fill(0.0));
        assert_eq!(judged(id, &blank, true).0, NOTHING, "{id:?}");
        // Single steps among those of an n-step batch are the last ones of their episodes.
        let ends: Vec<Row> = right.iter().filter(|row| row.4).cloned().collect();
        assert!(ends.is_empty() || judged(id, &ends, true).0.is_empty(), "{id:?}");
    }
}

#[test]
fn samples_of_many_steps_raise_no_alarm_and_are_not_said_to_be_steps() {
    let id = EnvironmentId::CartPoleV1;
    let one_step = rows(id, 400);
    for n in [2, 8, 9, 30] {
        // From each row as far as its episode goes, at most n steps.
        let last = |i: usize| {
            (i..(i + n).min(400)).find(|&j| one_step[j].4 || one_step[j].5).unwrap_or((i + n).min(400) - 1)
        };
        let sample = |i: usize| {
            let (first, last) = (&one_step[i], &one_step[last(i)]);
            (first.0.clone(), first.1, 1.0, last.3.clone(), last.4, last.5)
        };
        let right: Vec<Row> = (0..300).map(sample).collect();
        let discounts: Vec<f64> = (0..300).map(|i| 0.99_f64.powi((last(i) - i) as i32 + 1)).collect();
        let divided = |row: &Row| {
            let by = |x: &Vec<f64>| x.iter().zip([2.4, 2.0, 0.2095, 2.0]).map(|(x, by)| x / by).collect();
            (by(&row.0), row.1, row.2, by(&row.3), row.4, row.5)
        };
        for settings in [Settings::default(), Settings { environment: Some(id), ..Settings::default() }] {
            let (mistakes, facts) = judged_with_discounts(settings, id, &right, true, discounts.clone());
            assert_eq!(mistakes, NOTHING, "{n} {facts:?}");
            assert_eq!(
                facts.iter().any(|fact| fact.starts_with("all 300 rows are steps")),
                n <= 8,
                "{n} {facts:?}"
            );
            let divided: Vec<Row> = right.iter().map(divided).collect();
            let (mistakes, facts) = judged_with_discounts(settings, id, &divided, true, discounts.clone());
            assert_eq!(mistakes, NOTHING, "{n}, divided: {facts:?}");
        }
    }
}

#[test]
fn every_mistake_of_a_batch_is_named() {
    let task = EnvironmentId::CartPoleV1;
    let right = rows(task, 400);
    assert!(right.iter().any(|row| row.4) && right.iter().any(|row| row.5));
    let start = right[0].0.clone();
    let mut episode = start.clone();
    type Plant<'a> = &'a mut dyn FnMut(usize, &mut Row);
    let planted: [(&str, Plant<'_>); 14] = [
        ("one_transition_repeated", &mut |_, row| *row = right[0].clone()),
        ("next_is_current", &mut |_, row| row.0 = row.3.clone()),
        ("state_not_advanced", &mut |i, row| {
            if i > 0 && (right[i - 1].4 || right[i - 1].5) {
                episode.clone_from(&row.0);
            }
            row.0.clone_from(&episode);
        }),
        ("next_is_reset", &mut |_, row| {
            if row.4 || row.5 {
                row.3.clone_from(&start)
            }
        }),
        ("next_of_another_row", &mut |i, row| row.3.clone_from(&right[(i + 1) % 400].3)),
        ("observations_exchanged_in_batch", &mut |_, row| std::mem::swap(&mut row.0, &mut row.3)),
        ("stored_action_is_another", &mut |_, row| row.1 = 0),
        ("observations_rounded", &mut |_, row| {
            row.0.iter_mut().chain(&mut row.3).for_each(|x| *x = (*x * 10.0).round() / 10.0)
        }),
        ("row_that_never_happened", &mut |i, row| {
            if i % 9 == 0 {
                row.3[1] += 0.5
            }
        }),
        ("reward_and_end_exchanged", &mut |_, row| (row.2, row.4) = (f64::from(row.4), true)),
        ("end_of_another_step", &mut |i, row| row.4 = right[(i + 1) % 400].4),
        ("terminated_never_stored", &mut |_, row| row.4 = false),
        ("time_limit_stored_as_terminated", &mut |_, row| row.4 |= row.5),
        ("time_limit_stored_as_terminated", &mut |_, row| (row.4, row.5) = (row.4 || row.5, false)),
    ];
    for (id, plant) in planted {
        let mut rows = right.clone();
        rows.iter_mut().enumerate().for_each(|(i, row)| plant(i, row));
        assert_eq!(judged(task, &rows, true).0, [id]);
    }
    let id = EnvironmentId::AcrobotV1;
    let mut acrobot = rows(id, 60);
    // An end that is made up, so that rewards of 0 and −1 can be exchanged.
    acrobot.truncate(60);
    let mut stays = acrobot.clone();
    stays.iter_mut().for_each(|row| row.3 = row.0.clone());
    assert_eq!(judged(id, &stays, true).0, ["next_is_current"]);
    let right = rows_within(id, 10_000, 10_000);
    let ends = right.iter().position(|row| row.4).expect("an end");
    let around = &right[ends.saturating_sub(50)..right.len().min(ends + 50)];
    let mut shifted = around.to_vec();
    shifted.iter_mut().skip(1).zip(around).for_each(|(row, before)| row.2 = before.2);
    assert_eq!(judged(id, &shifted, true).0, ["reward_of_another_step"]);

    // Stepped on where the task has ended.
    let mut beyond = rows(task, 60);
    for i in 1..20 {
        let before = beyond[i - 1].3.clone();
        let (next, outcome) = task.step_from(&before, 1).unwrap();
        beyond[i] = (before, 1, 1.0, next, outcome.terminated, false);
    }
    let settings = Settings { environment: Some(task), ..Settings::default() };
    assert_eq!(judged_with(settings, task, &beyond, true).0, ["steps_after_the_end"]);
}

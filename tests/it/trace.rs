//! `check` of a recorded loop: reading it, and what it names in small loops that are made here.
//! `tests/interop/recorder.py` has loops that learn, recorded from Python.

use std::collections::HashMap;

use cartpole_dqn::check::trace::{Judgement, judge};
use cartpole_dqn::rng::Rng;
use cartpole_dqn::tensors::Tensors;
use predicates::prelude::*;

use crate::cli::Sandbox;

const STEPS: usize = 400;
const EPISODE: usize = 10;
const SIZE: usize = 8;

/// A loop in columns: episodes of ten steps, of which every third is cut off by a time limit, a memory of everything, and a
/// target network that is copied every 50 updates.
#[derive(Clone)]
struct Loop {
    observation: Vec<f32>,
    next_observation: Vec<f32>,
    action: Vec<u64>,
    reward: Vec<f64>,
    terminated: Vec<u64>,
    truncated: Vec<u64>,
    reset: Vec<u64>,
    step: Vec<u64>,
    online: Vec<u64>,
    target: Vec<u64>,
    loss: Vec<f64>,
    /// The update and the step of each row of the minibatches.
    rows: Vec<(u64, usize)>,
    settings: String,
    trace: String,
}

impl Loop {
    fn right() -> Self {
        let mut rng = Rng::from_seed(3);
        let all = || 0..STEPS;
        // An observation is the place in the loop; the last one of an episode is no first one.
        let place = |step: usize| (step + step / EPISODE) as f32;
        let is_end = |step: usize| (step + 1).is_multiple_of(EPISODE);
        let is_cut = |step: usize| is_end(step) && (step / EPISODE).is_multiple_of(3);
        let flags = |holds: &dyn Fn(usize) -> bool| all().map(|step| u64::from(holds(step))).collect();
        let updates = STEPS - 40;
        let rows = (0..updates as u64).step_by(4).flat_map(|update| {
            let known = (0..SIZE).map(|_| rng.uniform(0.0, 40.0 + update as f64) as usize);
            known.map(|step| (update, step)).collect::<Vec<_>>()
        });
        Self {
            observation: all().map(place).collect(),
            next_observation: all().map(|step| place(step) + 1.0).collect(),
            action: all().map(|step| step as u64 % 2).collect(),
            reward: all().map(|step| step as f64 / 7.0).collect(),
            terminated: flags(&|step| is_end(step) && !is_cut(step)),
            truncated: flags(&is_cut),
            reset: flags(&|step| step.is_multiple_of(EPISODE)),
            step: (0..updates as u64).map(|update| update + 41).collect(),
            online: (0..updates as u64).map(|update| update + 1).collect(),
            target: (0..updates as u64).map(|update| update - update % 50).collect(),
            loss: vec![1.0; updates],
            rows: rows.collect(),
            settings: "{\"gamma\":0.9}".into(),
            trace:
                "{\"version\":1,\"closed\":true,\"environment\":\"Mine-v0\",\"environments\":1,\"actions\":2}"
                    .into(),
        }
    }

    fn tensors(&self) -> Tensors {
        let mut tensors = Tensors::default();
        let (steps, updates, rows) = (self.observation.len(), self.step.len(), self.rows.len());
        let of = |step: usize| step % steps;
        let column =
            |of: &dyn Fn(usize) -> f64| -> Vec<f64> { self.rows.iter().map(|(_, step)| of(*step)).collect() };
        let wide =
            |values: &[f32]| -> Vec<f32> { values.iter().flat_map(|&value| [value, -value]).collect() };
        let of_rows =
            |values: &[f32]| wide(&self.rows.iter().map(|(_, step)| values[of(*step)]).collect::<Vec<_>>());
        let sample = |values: &[u64]| values.iter().map(|&value| value as f32).collect::<Vec<_>>();
        tensors.put("steps.observation", &[steps, 2], &wide(&self.observation));
        tensors.put("steps.next_observation", &[steps, 2], &wide(&self.next_observation));
        tensors.put("steps.action", &[steps], &self.action);
        tensors.put("steps.reward", &[steps], &self.reward);
        tensors.put("steps.terminated", &[steps], &self.terminated);
        tensors.put("steps.truncated", &[steps], &self.truncated);
        tensors.put("steps.reset", &[steps], &self.reset);
        tensors.put("updates.step", &[updates], &self.step);
        tensors.put("updates.online", &[updates, 1], &self.online);
        tensors.put("updates.target", &[updates, 1], &self.target);
        tensors.put("updates.online_sample", &[updates, 1], &sample(&self.online));
        tensors.put("updates.target_sample", &[updates, 1], &sample(&self.target));
        tensors.put("updates.loss", &[updates], &self.loss);
        tensors.put("updates.batch_size", &[updates], &vec![SIZE as u64; updates]);
        tensors.put(
            "batches.update",
            &[rows],
            &self.rows.iter().map(|(update, _)| *update).collect::<Vec<_>>(),
        );
        tensors.put("batches.observations", &[rows, 2], &of_rows(&self.observation));
        tensors.put("batches.next_observations", &[rows, 2], &of_rows(&self.next_observation));
        tensors.put("batches.actions", &[rows], &column(&|step| self.action[of(step)] as f64));
        tensors.put("batches.rewards", &[rows], &column(&|step| self.reward[of(step)]));
        tensors.put("batches.terminated", &[rows], &column(&|step| self.terminated[of(step)] as f64));
        tensors
    }

    fn bytes(&self) -> Vec<u8> {
        self.bytes_with(|_| ())
    }

    /// The file, with its tensors changed.
    fn bytes_with(&self, change: impl FnOnce(&mut Tensors)) -> Vec<u8> {
        let mut tensors = self.tensors();
        change(&mut tensors);
        let metadata = [("settings", &self.settings), ("trace", &self.trace)];
        let metadata: HashMap<_, _> = metadata.map(|(key, text)| (key.to_owned(), text.clone())).into();
        tensors.to_safetensors(Some(metadata)).unwrap()
    }
}

/// A text in one line.
fn words(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn judged(bytes: &[u8]) -> Judgement {
    judge(bytes, &|_, _, _| ()).unwrap()
}

fn names(bytes: &[u8]) -> Vec<&'static str> {
    judged(bytes).mistakes.iter().map(|named| named.mistake.id).collect()
}

#[test]
fn of_a_right_loop_check_says_what_it_does_and_names_nothing() {
    let sandbox = Sandbox::new();
    sandbox.write("dqn.trace", Loop::right().bytes());
    let assert = sandbox.run(&["check", "dqn.trace"]).code(0).stderr("");
    let text = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
    for fact in [
        "Mine-v0: 400 steps, 40 episodes ended, 26 terminated",
        "target network copied every 50 updates (every 50 steps)",
        "360 updates with minibatches of 8, the first after 41 steps, 1.00 per step",
        "the memory holds 377 rows or more",
        "nothing that could be seen is wrong",
    ] {
        assert!(words(&text).contains(fact), "{fact} is not in\n{text}");
    }
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
}

#[test]
fn planted_mistakes_are_named_and_shown_with_their_numbers() {
    type Plant = fn(&mut Loop);
    let plants: &[(&str, Plant)] = &[
        ("steps_after_the_end", |one| one.reset.fill(0)),
        ("same_start_every_episode", |one| {
            for step in (0..STEPS).step_by(EPISODE) {
                (one.observation[step], one.reset[step]) = (-5.0, 2);
            }
        }),
        ("one_transition_repeated", |one| {
            one.rows.chunks_mut(SIZE).for_each(|rows| {
                let first = rows[0];
                rows.fill(first);
            });
        }),
        ("samples_only_oldest", |one| one.rows.iter_mut().for_each(|(_, step)| *step %= 40)),
        ("samples_only_newest", |one| {
            one.rows.chunks_mut(SIZE).for_each(|rows| {
                let newest = rows[0].0 as usize + 40;
                rows.iter_mut().enumerate().for_each(|(row, (_, step))| *step = newest - row);
            });
        }),
        ("memory_too_small", |one| {
            one.rows.iter_mut().for_each(|(update, step)| *step = *update as usize + 40 - *step % (2 * SIZE));
        }),
        ("target_is_online", |one| one.target = one.online.clone()),
        ("online_never_changes", |one| one.online.fill(9)),
        ("diverges", |one| one.loss[300] = f64::INFINITY),
        ("learns_before_a_batch_is_there", |one| {
            one.step.iter_mut().enumerate().for_each(|(update, step)| *step = update as u64 + 2);
            one.rows.iter_mut().for_each(|(update, step)| *step %= *update as usize + 2);
        }),
    ];
    for (id, plant) in plants {
        let mut one = Loop::right();
        plant(&mut one);
        let judgement = judged(&one.bytes());
        let found = judgement.mistakes.iter().find(|named| named.mistake.id == *id);
        assert!(found.is_some(), "{id}: {:?}", judgement.mistakes);
        assert!(found.unwrap().evidence.contains(|c: char| c.is_ascii_digit()), "{found:?}");
    }
    // What is stored is not what happened.
    type Change = fn(f64) -> f64;
    let stored: &[(&str, &str, Change)] = &[
        ("stored_action_is_another", "batches.actions", |action| 1.0 - action),
        ("terminated_never_stored", "batches.terminated", |_| 0.0),
    ];
    for (id, column, change) in stored {
        let one = Loop::right();
        let rows = one.rows.len();
        let bytes = one.bytes_with(|tensors| {
            let values = tensors.get::<f64>(column, &[rows]).unwrap();
            tensors.put(column, &[rows], &values.into_iter().map(change).collect::<Vec<_>>());
        });
        assert_eq!(names(&bytes), [*id]);
    }
}

#[test]
fn a_loop_that_was_killed_is_judged_as_far_as_it_goes() {
    let sandbox = Sandbox::new();
    let mut one = Loop::right();
    one.trace = one.trace.replace("true", "false");
    sandbox.write("killed.trace", one.bytes());
    let not_closed =
        predicate::str::contains("the recorder was not closed").and(predicate::str::contains("step 400"));
    sandbox.run(&["check", "killed.trace"]).code(0).stdout(not_closed);

    // A file that was cut off wherever it may be.
    let mut one = Loop::right();
    one.reset.fill(0);
    let bytes = one.bytes();
    let header = 8 + usize::try_from(u64::from_le_bytes(bytes[..8].try_into().unwrap())).unwrap();
    let mut named = 0;
    for length in (header..bytes.len()).step_by(997) {
        let judgement = judged(&bytes[..length]);
        assert!(judgement.unseen[0].contains("is cut off"), "{:?}", judgement.unseen);
        assert!(judgement.mistakes.iter().all(|named| named.mistake.id == "steps_after_the_end"), "{length}");
        named += judgement.mistakes.len();
    }
    assert!(named > 0);
    sandbox.write("cut.trace", &bytes[..100]);
    sandbox.refuses(&["check", "cut.trace"], &["cut.trace", "cut off or damaged"]);
}

#[test]
fn what_is_no_trace_is_refused_with_one_message() {
    let one = Loop::right();
    let changed = |change: &dyn Fn(&mut Tensors)| one.bytes_with(change);
    let metadata = |from: &str, to: &str| {
        let other = Loop {
            trace: one.trace.replace(from, to),
            settings: one.settings.replace(from, to),
            ..one.clone()
        };
        other.bytes()
    };
    let cases: Vec<(Vec<u8>, &[&str])> = vec![
        (metadata("\"version\":1", "\"version\":2"), &["version 2", "reads version 1", "same release"]),
        (metadata("\"version\":1", "\"version\":\"x\""), &["version \"x\"", "reads version 1"]),
        (metadata("{\"version\"", "[\"version\""), &["metadata `trace`", "cannot be read"]),
        (metadata("\"actions\":2", "\"actions\":-2"), &["metadata `trace`", "-2"]),
        (metadata("0.9", "1.9"), &["`gamma` is 1.9", "from 0 to 1"]),
        (metadata("gamma", "gama"), &["metadata `settings`", "gama"]),
        (
            changed(&|t| t.put("steps.reward", &[3], &[1.0, 2.0, 3.0])),
            &["`steps.reward` has the shape [3]", "400 rows"],
        ),
        (changed(&|t| t.put("steps.reward", &[1, 1, 1], &[1.0])), &["`steps.reward`", "[1, 1, 1]"]),
        (
            changed(&|t| t.put("steps.action", &[STEPS], &[0.5; STEPS])),
            &["`steps.action` holds 0.5", "whole numbers"],
        ),
        (
            changed(&|t| t.put("steps.observation", &[STEPS, 2], &[f32::NAN; 2 * STEPS])),
            &["`steps.observation` holds NaN in row 0", "finite"],
        ),
        (
            changed(&|t| t.put("steps.observation", &[STEPS, 1], &[0.0; STEPS])),
            &["`steps.observation`", "differ"],
        ),
        (changed(&|t| t.put::<f64>("steps.reward", &[STEPS, 0], &[])), &["`steps.reward`", "[400, 0]"]),
        (
            changed(&|t| t.put("steps.action", &[STEPS, 2], &[0_u64; 2 * STEPS])),
            &["`steps.action`", "400, 2"],
        ),
        (changed(&|t| t.put("updates.step", &[360], &[401_u64; 360])), &["`updates.step`", "at most 400"]),
        (
            changed(&|t| t.put("batches.update", &[one.rows.len()], &vec![360_u64; one.rows.len()])),
            &["below 360"],
        ),
        (
            {
                let mut tensors = Tensors::default();
                tensors.put("steps.action", &[1], &[0_u64]);
                let metadata = HashMap::from([("trace".to_owned(), one.trace.clone())]);
                tensors.to_safetensors(Some(metadata)).unwrap()
            },
            &["no tensor `steps.observation`"],
        ),
        (
            {
                let metadata = HashMap::from([("trace".to_owned(), one.trace.clone())]);
                Tensors::default().to_safetensors(Some(metadata)).unwrap()
            },
            &["holds no step and no update", "recorder.environment"],
        ),
    ];
    let sandbox = Sandbox::new();
    for (bytes, words) in cases {
        sandbox.write("bad.trace", bytes);
        sandbox.refuses(&["check", "bad.trace"], &[&["bad.trace"], words].concat());
    }
}

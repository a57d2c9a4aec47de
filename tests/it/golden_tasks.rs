//! Acrobot and MountainCar against episodes recorded from Gymnasium.

use cartpole_dqn::env::catalogue::EnvironmentId;
use cartpole_dqn::env::{Acrobot, Environment, MountainCar, Start};
use serde::Deserialize;

#[derive(Deserialize)]
struct Episode {
    seed: u64,
    initial_state: Vec<f64>,
    actions: Vec<usize>,
    rewards: Vec<f64>,
    states: Vec<Vec<f64>>,
    observations: Vec<Vec<f64>>,
    terminated: bool,
    truncated: bool,
}

/// A task, its recording, and how to put its physics into a recorded state.
struct Task {
    recording: &'static str,
    id: EnvironmentId,
    at: fn(&[f64]) -> Box<dyn Environment>,
}

const ACROBOT: Task = Task {
    recording: "gymnasium_acrobot_v1.json",
    id: EnvironmentId::AcrobotV1,
    at: |state| Box::new(Acrobot::at(state.try_into().unwrap())),
};
const MOUNTAIN_CAR: Task = Task {
    recording: "gymnasium_mountain_car_v0.json",
    id: EnvironmentId::MountainCarV0,
    at: |state| Box::new(MountainCar::at(state.try_into().unwrap())),
};

impl Task {
    fn episodes(&self) -> Vec<Episode> {
        let episodes: Vec<Episode> =
            serde_json::from_value(crate::golden(self.recording)["episodes"].clone()).unwrap();
        assert!(episodes.iter().any(|episode| episode.terminated), "some episode reaches the goal");
        assert!(episodes.iter().any(|episode| episode.truncated), "some episode does not");
        episodes
    }

    fn every_transition_agrees(&self) {
        let spec = self.id.spec();
        for episode in self.episodes() {
            let mut limit = self.id.make(spec.max_steps).unwrap();
            let mut observation = vec![0.0; spec.observation_size];
            limit.reset(Start::Seed(episode.seed), &mut observation).unwrap();
            assert!(!episode.actions.is_empty() && episode.actions.len() == episode.states.len());
            let befores = std::iter::once(&episode.initial_state).chain(&episode.states);
            for (index, (before, &action)) in befores.zip(&episode.actions).enumerate() {
                let place = format!("{}, seed {}, step {index}", spec.id, episode.seed);
                let truncates = limit.step(action, &mut observation).unwrap().truncated;
                let mut physics = (self.at)(before);
                let outcome = physics.step(action, &mut observation).unwrap();
                agrees(physics.state().unwrap(), &episode.states[index], 1e-14, &place);
                let seen: Vec<f64> = observation.iter().map(|&value| f64::from(value)).collect();
                agrees(&seen, &episode.observations[index + 1], f64::from(f32::EPSILON), &place);
                let last = index + 1 == episode.actions.len();
                assert_eq!(outcome.reward, episode.rewards[index], "{place}");
                assert_eq!(outcome.terminated, last && episode.terminated, "{place}");
                assert_eq!(truncates, last && episode.truncated, "{place}");
            }
        }
    }

    fn every_reset_agrees_to_the_bit(&self) {
        let spec = self.id.spec();
        for Episode { seed, initial_state, observations, .. } in self.episodes() {
            let mut environment = self.id.make(spec.max_steps).unwrap();
            let mut observation = vec![0.0; spec.observation_size];
            environment.reset(Start::Seed(seed), &mut observation).unwrap();
            let bits = |state: &[f64]| state.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(environment.state().unwrap()), bits(&initial_state), "seed {seed}");
            for (&ours, &theirs) in observation.iter().zip(&observations[0]) {
                // Gymnasium takes Acrobot's first cosines and sines of 32-bit numbers.
                let ulps = ours.to_bits().abs_diff((theirs as f32).to_bits());
                assert!(ulps <= 1, "seed {seed}: {ours} for {theirs}");
            }
        }
    }
}

/// Equal but for `tolerance`, relative to the value or to 1, whichever is larger.
fn agrees(ours: &[f64], theirs: &[f64], tolerance: f64, place: &str) {
    assert_eq!(ours.len(), theirs.len());
    for (ours, theirs) in ours.iter().zip(theirs) {
        assert!((ours - theirs).abs() <= tolerance * theirs.abs().max(1.0), "{place}: {ours} for {theirs}");
    }
}

#[test]
fn golden_acrobot_transitions() {
    ACROBOT.every_transition_agrees();
}

#[test]
fn golden_acrobot_resets() {
    ACROBOT.every_reset_agrees_to_the_bit();
}

#[test]
fn golden_mountain_car_transitions() {
    MOUNTAIN_CAR.every_transition_agrees();
}

#[test]
fn golden_mountain_car_resets() {
    MOUNTAIN_CAR.every_reset_agrees_to_the_bit();
}

#[test]
fn no_return_of_a_recording_is_outside_of_the_range_that_the_task_declares() {
    for task in [ACROBOT, MOUNTAIN_CAR] {
        let (low, high) = task.id.spec().return_range;
        for episode in task.episodes() {
            let total: f64 = episode.rewards.iter().sum();
            assert!((low..=high).contains(&total), "{total}");
        }
    }
}

/// Whoever draws an episode takes its first scene's shapes and moves them.
#[test]
fn all_scenes_of_an_episode_have_the_same_shapes_and_few_colors() {
    for name in EnvironmentId::NAMES {
        let mut environment = EnvironmentId::from_name(name).unwrap().make(100).unwrap();
        let mut observation = vec![0.0; environment.spec().observation_size];
        environment.reset(Start::Seed(1), &mut observation).unwrap();
        let actions = environment.spec().num_actions;
        let shapes = |environment: &dyn Environment| -> Vec<_> {
            let scene = environment.scene().unwrap();
            scene.shapes.into_iter().map(|shape| (shape.outline, shape.color)).collect()
        };
        let first = shapes(&*environment);
        let mut colors: Vec<_> = first.iter().map(|(_, color)| color.rgb()).collect();
        colors.sort_unstable();
        colors.dedup();
        assert!(colors.len() <= 5, "{name}");
        for step in 0..100 {
            let ended = environment.step(step / 7 % actions, &mut observation).unwrap().ended();
            assert_eq!(shapes(&*environment), first, "{name}, step {step}");
            if ended {
                break;
            }
        }
    }
}

/// A page writes values of both axes into an observation, and reads where an episode is out of others.
#[test]
fn what_a_map_writes_into_an_observation_it_reads_again() {
    for name in EnvironmentId::NAMES {
        let spec = EnvironmentId::from_name(name).unwrap().spec();
        for axis in spec.map.unwrap() {
            let (low, high) = axis.range;
            for share in [0.01, 0.3, 0.5, 0.99] {
                let value = low + share * (high - low);
                let mut observation = vec![0.0; spec.observation_size];
                axis.write(value, &mut observation);
                let read = axis.read(&observation);
                assert!(
                    (read - value).abs() < 1e-5 * (high - low),
                    "{name}, {}: {read} for {value}",
                    axis.name
                );
            }
        }
    }
}

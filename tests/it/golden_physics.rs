//! The physics against episodes recorded from Gymnasium.

use cartpole_dqn::env::{CartPole, Environment, Start};
use serde::Deserialize;

#[derive(Deserialize)]
struct Episode {
    seed: u64,
    initial_state: [f64; 4],
    actions: Vec<usize>,
    states: Vec<[f64; 4]>,
    terminated: bool,
    truncated: bool,
}

fn episodes(recording: &serde_json::Value) -> Vec<Episode> {
    let episodes: Vec<Episode> = serde_json::from_value(recording["episodes"].clone()).unwrap();
    assert!(!episodes.is_empty());
    episodes
}

fn every_transition_agrees(recording: &serde_json::Value) {
    for Episode { seed, initial_state, actions, states, terminated, truncated } in episodes(recording) {
        // The time limit counts; the state before each step is the recorded one, because the pole is unstable.
        let mut limit = CartPole::v1();
        let mut observation = [0.0; 4];
        limit.reset(Start::Seed(seed), &mut observation).unwrap();
        assert!(!actions.is_empty() && actions.len() == states.len(), "seed {seed}");
        let befores = std::iter::once(&initial_state).chain(&states);
        for (index, ((before, after), &action)) in befores.zip(&states).zip(&actions).enumerate() {
            let mut physics = CartPole::at(*before);
            let outcome = physics.step(action, &mut observation).unwrap();
            let truncates = limit.step(action, &mut [0.0; 4]).unwrap().truncated;
            for (ours, theirs) in physics.state().unwrap().iter().zip(after) {
                assert!((ours - theirs).abs() <= 1e-14, "seed {seed}, step {index}: {ours} for {theirs}");
            }
            assert_eq!(observation, after.map(|coordinate| coordinate as f32));
            assert_eq!(outcome.reward, 1.0);
            let last = index + 1 == actions.len();
            assert_eq!(outcome.terminated, last && terminated, "seed {seed}, step {index}");
            assert_eq!(truncates, last && truncated, "seed {seed}, step {index}");
        }
    }
}

fn every_reset_agrees_to_the_bit(recording: &serde_json::Value) {
    for Episode { seed, initial_state, .. } in episodes(recording) {
        let mut environment = CartPole::v1();
        let mut observation = [0.0; 4];
        environment.reset(Start::Seed(seed), &mut observation).unwrap();
        let bits = |state: &[f64]| state.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(environment.state().unwrap()), bits(&initial_state), "seed {seed}");
        assert_eq!(observation, initial_state.map(|coordinate| coordinate as f32), "seed {seed}");
    }
}

#[test]
fn golden_gymnasium_transitions() {
    every_transition_agrees(&crate::golden("gymnasium_cartpole_v1.json"));
}

#[test]
fn golden_gymnasium_resets() {
    every_reset_agrees_to_the_bit(&crate::golden("gymnasium_cartpole_v1.json"));
}

/// Episodes that end on |x|, at the time limit, and on both at once; seeds of two words.
#[test]
fn golden_gymnasium_edges() {
    // Somebody's own recordings need not have this one.
    let recording = crate::recording(&crate::own_recordings(), "gymnasium_cartpole_edges.json");
    every_transition_agrees(&recording);
    every_reset_agrees_to_the_bit(&recording);
    let ends_on_x = |episode: &Episode| {
        let [x, _, theta, _] = *episode.states.last().unwrap();
        episode.terminated && x.abs() > 2.4 && theta.abs() < 0.2
    };
    assert!(episodes(&recording).iter().any(ends_on_x));
}

#[test]
fn the_limits_are_gymnasiums() {
    let max_angle = 12.0 * 2.0 * std::f64::consts::PI / 360.0;
    for (state, terminated) in [
        ([2.4, 0.0, 0.0, 0.0], false),
        ([2.4 + 1e-9, 0.0, 0.0, 0.0], true),
        ([-2.4 - 1e-9, 0.0, 0.0, 0.0], true),
        ([0.0, 0.0, max_angle, 0.0], false),
        ([0.0, 0.0, max_angle + 1e-9, 0.0], true),
        ([0.0, 0.0, -max_angle - 1e-9, 0.0], true),
    ] {
        // A step with no velocity leaves x and θ where they are.
        let outcome = CartPole::at(state).step(0, &mut [0.0; 4]).unwrap();
        assert_eq!(outcome.terminated, terminated, "{state:?}");
    }
}

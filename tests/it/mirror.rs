//! CartPole and Acrobot are their own mirror images, and `replay.mirror` makes use of it.

use cartpole_dqn::agent::{Agent, Dqn, Minibatch, Replay, Transition};
use cartpole_dqn::env::{Acrobot, CartPole, Environment};
use cartpole_dqn::mirror::Mirror;
use cartpole_dqn::rng::Rng;

use super::tasks::random_steps;

/// The image of an observation, written out.
fn image(mirror: &Mirror, observation: &[f32]) -> Vec<f32> {
    mirror.observation.iter().map(|&(from, factor)| factor * observation[from]).collect()
}

/// Random states, far beyond what an episode reaches too: every coordinate, reward and end of the image, bit for bit.
#[test]
fn the_step_from_a_mirror_image_is_the_mirror_image_of_the_step() {
    let mirror = CartPole::default().spec().mirror.clone().unwrap();
    let mut rng = Rng::from_seed(77);
    for _ in 0..10_000 {
        let state = [3.0, 5.0, 0.3, 5.0].map(|range| rng.uniform(-range, range));
        let action = rng.below(2) as usize;
        let (mut here, mut there) = (CartPole::at(state), CartPole::at(state.map(|value| -value)));
        let (mut seen, mut reflected) = ([0.0; 4], [0.0; 4]);
        let outcome = here.step(action, &mut seen).unwrap();
        assert_eq!(there.step(usize::from(mirror.actions[action]), &mut reflected).unwrap(), outcome);
        let expected: Vec<f64> = here.state().unwrap().iter().map(|value| -value).collect();
        assert_eq!(there.state().unwrap(), expected);
        assert_eq!(reflected.to_vec(), image(&mirror, &seen));
    }
}

/// Random states within Acrobot's limits. Its equations hold cos(θ − π/2), which is odd but for its last bits.
#[test]
fn the_step_from_the_mirror_image_of_an_acrobot_is_the_mirror_image_but_for_rounding() {
    use std::f64::consts::PI;
    let mirror = Acrobot::default().spec().mirror.clone().unwrap();
    let close = |ours: f64, theirs: f64| (ours - theirs).abs() < 1e-11;
    let mut rng = Rng::from_seed(78);
    for _ in 0..10_000 {
        let state = [PI, PI, 4.0 * PI, 9.0 * PI].map(|range| rng.uniform(-range, range));
        let action = rng.below(3) as usize;
        let (mut here, mut there) = (Acrobot::at(state), Acrobot::at(state.map(|value| -value)));
        let (mut seen, mut reflected) = ([0.0; 6], [0.0; 6]);
        let outcome = here.step(action, &mut seen).unwrap();
        assert_eq!(there.step(usize::from(mirror.actions[action]), &mut reflected).unwrap(), outcome);
        for (ours, theirs) in there.state().unwrap().iter().zip(here.state().unwrap()) {
            // An angle next to π can be wrapped to −π.
            assert!(close(*ours, -theirs) || close((ours + theirs).abs(), 2.0 * PI), "{state:?}");
        }
        for (ours, theirs) in reflected.iter().zip(image(&mirror, &seen)) {
            assert!((ours - theirs).abs() <= f32::EPSILON * theirs.abs().max(1.0), "{state:?}");
        }
    }
}

/// A task whose mirror exchanges coordinates that are divided by different numbers, and three actions.
fn odd_mirror() -> Mirror {
    Mirror { observation: vec![(1, -1.0), (0, -1.0), (2, 1.0)], actions: vec![2, 1, 0] }
}

fn filled(reflected: bool, scale: [f32; 3]) -> Replay {
    let (mirror, mut rng) = (odd_mirror(), Rng::from_seed(5));
    let mut replay = Replay::new(40, 3);
    let mut draw = || -> Vec<f32> { (0..3).map(|_| rng.uniform(-1.0, 1.0) as f32).collect() };
    let mut observation = draw();
    for step in 0..60 {
        let next_observation = draw();
        let seen = |observation: &[f32]| -> Vec<f32> {
            let raw = if reflected { image(&mirror, observation) } else { observation.to_vec() };
            raw.iter().zip(scale).map(|(value, scale)| value / scale).collect()
        };
        let action = step % 3;
        replay.push(Transition {
            observation: &seen(&observation),
            action: if reflected { usize::from(mirror.actions[action]) } else { action },
            reward: step as f32,
            next_observation: &seen(&next_observation),
            terminated: step % 7 == 6,
            truncated: step % 11 == 10,
        });
        observation = next_observation;
    }
    replay
}

/// Powers of two divide exactly.
#[test]
fn the_image_of_a_window_is_the_window_of_the_images() {
    let scale = [0.5, 4.0, 2.0];
    let (plain, reflected) = (filled(false, scale), filled(true, scale));
    let ages: Vec<usize> = (0..plain.len()).collect();
    for n_step in [1, 3] {
        let [mut ours, mut expected] = [(); 2].map(|()| Minibatch::new(ages.len(), 3));
        plain.gather(&ages, n_step, 0.9, &mut ours);
        reflected.gather(&ages, n_step, 0.9, &mut expected);
        let before = ours.clone();
        let mirror = odd_mirror().of_divided(&scale);
        ages.iter().for_each(|&sample| ours.reflect(sample, &mirror, &mut Vec::new()));
        assert_eq!(ours, expected);
        ages.iter().for_each(|&sample| ours.reflect(sample, &mirror, &mut Vec::new()));
        assert_eq!(ours, before, "the image of the image");
    }
}

/// An agent that has seen 60 transitions of CartPole, or their images.
fn experienced(sets: &[&str], reflected: bool) -> Dqn {
    let mirror = CartPole::default().spec().mirror.clone();
    let small = ["network.hidden=[6]", "replay.batch_size=1", "replay.warmup_steps=8", "n_step=3"];
    let sets: Vec<String> = small.iter().chain(sets).map(ToString::to_string).collect();
    let mut agent = Dqn::new(super::plain(&sets).agent.as_dqn().unwrap().clone(), 4, 2, mirror.as_ref(), 3);
    let sign = if reflected { -1.0 } else { 1.0 };
    random_steps(60, |observation, action, next_observation, outcome| {
        agent.observe(Transition {
            observation: &observation.map(|value| sign * value),
            action: if reflected { 1 - action } else { action },
            reward: outcome.reward as f32,
            next_observation: &next_observation.map(|value| sign * value),
            terminated: outcome.terminated,
            truncated: outcome.truncated,
        });
    });
    agent
}

#[test]
fn a_coin_after_the_ages_decides_whether_a_sample_is_reflected() {
    let mut seen = [0; 2];
    for seed in 0..20 {
        let mut agent = experienced(&["replay.mirror=true"], false);
        agent.replay_rng = Rng::from_seed(seed);
        let mut rng = agent.replay_rng.clone();
        let loss = agent.learn().unwrap();

        agent.replay.clone().sample(&mut rng, &mut [0]);
        let coin = rng.below(2) == 1;
        assert_eq!(agent.replay_rng, rng, "one age and one coin");
        let mut expected = experienced(&[], coin);
        expected.replay_rng = Rng::from_seed(seed);
        assert_eq!(loss, expected.learn().unwrap());
        assert_eq!(agent.online.mlp, expected.online.mlp);
        seen[usize::from(coin)] += 1;
    }
    assert!(seen[0] > 3 && seen[1] > 3, "{seen:?}");
}

//! The replay memory against a queue of whole transitions.

use std::collections::VecDeque;

use cartpole_dqn::agent::{Minibatch, Replay, Transition};
use cartpole_dqn::rng::Rng;

#[derive(Clone, Debug, PartialEq)]
struct Whole {
    observation: [f32; 2],
    action: u8,
    reward: f32,
    next_observation: [f32; 2],
    terminated: bool,
}

/// Everything in the memory, the oldest first, as a minibatch would see it.
fn contents(replay: &Replay) -> Vec<Whole> {
    let ages: Vec<usize> = (0..replay.len()).collect();
    let mut minibatch = Minibatch::new(ages.len(), 2);
    replay.gather(&ages, 1, 0.5, &mut minibatch);
    assert!(minibatch.discounts.iter().all(|&discount| discount == 0.5));
    let row = |matrix: &nalgebra::DMatrix<f32>, age| [matrix[(age, 0)], matrix[(age, 1)]];
    ages.iter()
        .map(|&age| Whole {
            observation: row(&minibatch.observations, age),
            action: minibatch.actions[age],
            reward: minibatch.rewards[age],
            next_observation: row(&minibatch.next_observations, age),
            terminated: minibatch.terminated[age],
        })
        .collect()
}

#[test]
fn holds_what_a_queue_of_whole_transitions_holds() {
    for capacity in [1, 2, 3, 7, 64] {
        for (terminates, truncates) in [(4, 9), (1, 3), (2, 1), (1000, 5), (1000, 1000)] {
            let mut rng = Rng::from_seed(capacity as u64 + 100 * terminates);
            let mut replay = Replay::new(capacity, 2);
            let mut queue: VecDeque<Whole> = VecDeque::new();
            let mut fresh = 0.0;
            let mut observe = || {
                fresh += 1.0;
                [fresh, -fresh]
            };
            let mut observation = observe();
            for step in 0..300 {
                let next_observation = observe();
                let (terminated, truncated) = (rng.below(terminates) == 0, rng.below(truncates) == 0);
                let action = rng.below(2) as u8;
                let reward = step as f32;
                replay.push(Transition {
                    observation: &observation,
                    action: usize::from(action),
                    reward,
                    next_observation: &next_observation,
                    terminated,
                    truncated,
                });
                queue.push_back(Whole { observation, action, reward, next_observation, terminated });
                if queue.len() > capacity {
                    queue.pop_front();
                }
                assert_eq!(contents(&replay), Vec::from(queue.clone()), "capacity {capacity}, step {step}");
                observation = if terminated || truncated { observe() } else { next_observation };

                let saved = replay.contents();
                let mut restored = Replay::new(capacity, 2);
                assert!(restored.restore(&saved, 2));
                assert_eq!(contents(&restored), contents(&replay));
                assert_eq!(restored.contents(), saved);
            }
        }
    }
}

/// A step of an episode as a naive n-step learner keeps it.
struct Remembered {
    observation: [f32; 2],
    reward: f32,
    next_observation: [f32; 2],
    terminated: bool,
    ended: bool,
}

/// Walks on from transition `first` of all that there ever was, as long as the episode goes on.
fn naive_window(steps: &[Remembered], first: usize, n_step: usize, gamma: f32) -> (f32, f32, &Remembered) {
    let (mut reward, mut discount) = (0.0, 1.0);
    for step in &steps[first..] {
        reward += discount * step.reward;
        discount *= gamma;
        let length = steps[first..].iter().position(|other| std::ptr::eq(other, step)).unwrap() + 1;
        if step.ended || length == n_step {
            return (reward, discount, step);
        }
    }
    (reward, discount, &steps[steps.len() - 1])
}

/// Episodes that terminate and are truncated, a ring that wraps around, and windows at its write position.
#[test]
fn windows_of_n_steps_are_those_of_whole_episodes() {
    let gamma = 0.9;
    let mut windows_cut_short = 0;
    for capacity in [1, 2, 5, 13, 64] {
        for (terminates, truncates) in [(4, 9), (1, 3), (1000, 5), (7, 1000), (1000, 1000)] {
            let mut rng = Rng::from_seed(capacity as u64 + 100 * terminates);
            let mut replay = Replay::new(capacity, 2);
            let mut steps: Vec<Remembered> = Vec::new();
            let mut observation = [0.0, 0.5];
            for step in 0..150 {
                let next_observation = [step as f32 + 1.0, -(step as f32)];
                let (terminated, truncated) = (rng.below(terminates) == 0, rng.below(truncates) == 0);
                let reward = rng.uniform(-1.0, 1.0) as f32;
                replay.push(Transition {
                    observation: &observation,
                    action: 1,
                    reward,
                    next_observation: &next_observation,
                    terminated,
                    truncated,
                });
                let ended = terminated || truncated;
                steps.push(Remembered { observation, reward, next_observation, terminated, ended });
                observation = if ended { [step as f32 + 1000.0, 0.25] } else { next_observation };

                let ages: Vec<usize> = (0..replay.len()).collect();
                let oldest = steps.len() - ages.len();
                for n_step in [1, 2, 3, 7, 100] {
                    let mut minibatch = Minibatch::new(ages.len(), 2);
                    replay.gather(&ages, n_step, gamma, &mut minibatch);
                    for &age in &ages {
                        let (reward, discount, last) = naive_window(&steps, oldest + age, n_step, gamma);
                        let row = |matrix: &nalgebra::DMatrix<f32>| [matrix[(age, 0)], matrix[(age, 1)]];
                        let what = format!("capacity {capacity}, step {step}, age {age}, n {n_step}");
                        assert_eq!(row(&minibatch.observations), steps[oldest + age].observation, "{what}");
                        assert_eq!(row(&minibatch.next_observations), last.next_observation, "{what}");
                        assert_eq!(minibatch.terminated[age], last.terminated, "{what}");
                        assert_eq!(minibatch.rewards[age].to_bits(), reward.to_bits(), "{what}");
                        assert_eq!(minibatch.discounts[age].to_bits(), discount.to_bits(), "{what}");
                        windows_cut_short += usize::from(n_step == 7 && discount != gamma.powi(7));
                    }
                }
            }
        }
    }
    assert!(windows_cut_short > 1000);
}

#[test]
fn refuses_contents_that_do_not_fit_together() {
    let mut replay = Replay::new(4, 2);
    for step in 0..6 {
        let observation = [step as f32; 2];
        let transition = Transition {
            observation: &observation,
            action: 1,
            reward: 1.0,
            next_observation: &[step as f32 + 1.0; 2],
            terminated: step == 4,
            truncated: false,
        };
        replay.push(transition);
    }
    let good = replay.contents();
    assert!(Replay::new(4, 2).restore(&good, 2));
    assert!(!Replay::new(3, 2).restore(&good, 2), "too many transitions");
    assert!(!Replay::new(4, 2).restore(&good, 1), "an action that does not exist");
    let spoilt = |spoil: &dyn Fn(&mut cartpole_dqn::agent::ReplayContents)| {
        let mut contents = good.clone();
        spoil(&mut contents);
        !Replay::new(4, 2).restore(&contents, 2)
    };
    assert!(spoilt(&|contents| contents.ends[0] = 3));
    assert!(spoilt(&|contents| contents.rewards.truncate(2)));
    assert!(spoilt(&|contents| contents.observations.truncate(2)));
    assert!(spoilt(&|contents| contents.next_observations.truncate(2)));
    assert!(spoilt(&|contents| contents.next_observations.extend([0.0; 2])));
    assert!(spoilt(&|contents| contents.next_observations.push(0.0)));
}

#[test]
fn samples_are_distinct_and_uniform() {
    let mut replay = Replay::new(10, 1);
    for step in 0..25 {
        let (observation, next_observation) = ([step as f32], [step as f32 + 1.0]);
        replay.push(Transition {
            observation: &observation,
            action: 0,
            reward: 0.0,
            next_observation: &next_observation,
            terminated: false,
            truncated: false,
        });
    }
    let mut rng = Rng::from_seed(5);
    let mut counts = [[0; 10]; 3];
    for _ in 0..20_000 {
        let mut ages = [0; 3];
        replay.sample(&mut rng, &mut ages);
        assert!(ages[0] != ages[1] && ages[0] != ages[2] && ages[1] != ages[2], "{ages:?}");
        ages.iter().zip(&mut counts).for_each(|(&age, counts)| counts[age] += 1);
    }
    // 2,000 expected in each place, standard deviation 42.
    assert!(counts.as_flattened().iter().all(|&count| (1_800..2_200).contains(&count)), "{counts:?}");
    let mut everything: Vec<usize> = vec![0; 10];
    replay.sample(&mut rng, &mut everything);
    everything.sort_unstable();
    assert_eq!(everything, (0..10).collect::<Vec<_>>());
}

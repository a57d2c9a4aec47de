#![allow(clippy::unwrap_used)]

use super::*;
use crate::env::CartPole;
use crate::env::catalogue::EnvironmentId;
use crate::trainer::evaluate;
use crate::view::tests::{policy, text};

/// The cart and the pole without their picture.
struct Unseen(CartPole);

impl Environment for Unseen {
    fn spec(&self) -> &Spec {
        self.0.spec()
    }

    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()> {
        self.0.reset(start, observation)
    }

    fn step(&mut self, action: usize, observation: &mut [f32]) -> Answer<Outcome> {
        self.0.step(action, observation)
    }
}

#[test]
fn an_environment_without_a_picture_is_shown_as_numbers() {
    let player = Player::new(policy().greedy(1), Box::new(Unseen(CartPole::default())), 7).unwrap();
    let shown = text(40, 8, |frame| player.draw(frame, frame.area(), Block::bordered()));
    assert!(shown.contains(&format!(" x {:.4}", player.state()[0])), "{shown}");
    let seen = self::player(policy().greedy(1));
    let shown = text(40, 8, |frame| seen.draw(frame, frame.area(), Block::bordered()));
    assert!(!shown.contains(" x ") && shown.contains('⣿'), "{shown}");
}

fn player(policy: Greedy) -> Player {
    Player::new(policy, Box::new(CartPole::v1()), 7).unwrap()
}

fn play_on(player: &mut Player) -> u64 {
    while player.end.is_none() {
        player.step().unwrap();
    }
    player.steps
}

#[test]
fn plays_the_episodes_that_an_evaluation_plays() {
    let make = |max_steps| EnvironmentId::CartPoleV1.make(max_steps);
    let expected = evaluate(&policy(), &make, 500, 7, 3, 1.0).unwrap();
    let mut player = player(policy().greedy(1));
    for (seed, expected) in (7..).zip(expected) {
        player.start(seed).unwrap();
        assert_eq!(play_on(&mut player), expected.steps);
    }
    assert_eq!(player.returns.len(), 3);
    assert!(player.returns.iter().all(|(_, pushed)| !pushed));
}

#[test]
fn q_values_are_in_raw_rewards_and_the_scale_changes_no_action() {
    let mut plain = player(policy().greedy(1));
    let mut scaled = player(policy().greedy(1).with_reward_scale(0.25));
    while plain.end.is_none() {
        assert_eq!(scaled.q_values, plain.q_values.iter().map(|q| 4.0 * q).collect::<Vec<_>>());
        assert_eq!(scaled.action, plain.action);
        plain.step().unwrap();
        scaled.step().unwrap();
    }
}

#[test]
fn a_push_is_three_actions_of_the_one_who_pushes() {
    let [mut free, mut pushed] = [(); 2].map(|()| player(policy().greedy(1)));
    for player in [&mut free, &mut pushed] {
        (0..10).for_each(|_| player.step().unwrap());
    }
    pushed.push(1);
    for left in [2, 1] {
        pushed.step().unwrap();
        assert_eq!(pushed.push, Some((1, left)));
    }
    pushed.step().unwrap();
    assert_eq!(pushed.push, None);
    // 3 × 0.02 s × 10 N against 1.1 kg, and what the pole adds.
    let gained = pushed.state()[1] - {
        (0..3).for_each(|_| free.step().unwrap());
        free.state()[1]
    };
    assert!(gained > 0.1, "{gained}");
    play_on(&mut pushed);
    assert!(pushed.returns[0].1, "the return is marked");
    pushed.start(8).unwrap();
    assert!(!pushed.pushed);
}

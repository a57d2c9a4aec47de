//! An agent at play, step by step.

use crate::agent::{Greedy, Policy};
use crate::env::{CartPole, Environment, Step, TimeLimit};
use crate::rng::Rng;

/// The task that is played.
pub(super) type Task = TimeLimit<CartPole>;

/// Steps of a push: 0.06 s.
pub(super) const PUSH_STEPS: u32 = 3;

/// An episode that a greedy policy plays, and the returns of those before it.
pub(super) struct Player {
    policy: Greedy,
    environment: Task,
    observation: [f32; 4],
    /// Gymnasium's seed of the episode.
    pub(super) seed: u64,
    /// Steps of the episode so far, and, as every reward is 1, its return.
    pub(super) steps: u64,
    /// What the policy chooses next.
    pub(super) action: usize,
    /// What it expects of each action, in units of the environment's rewards.
    pub(super) q_values: [f32; 2],
    /// An action that somebody else has chosen, for as many steps.
    pub(super) push: Option<(usize, u32)>,
    /// Whether there was one in this episode.
    pub(super) pushed: bool,
    /// The last step of the episode.
    pub(super) end: Option<Step<[f32; 4]>>,
    /// The returns of the episodes that have ended, and whether there was a push.
    pub(super) returns: Vec<(u64, bool)>,
}

impl Player {
    pub(super) fn new(policy: Greedy, seed: u64) -> Self {
        let mut player = Self {
            policy,
            environment: CartPole::v1(),
            observation: [0.0; 4],
            seed,
            steps: 0,
            action: 0,
            q_values: [0.0; 2],
            push: None,
            pushed: false,
            end: None,
            returns: Vec::new(),
        };
        player.start(seed);
        player
    }

    /// Starts the episode of a seed.
    pub(super) fn start(&mut self, seed: u64) {
        self.observation = self.environment.reset(&mut Rng::from_seed(seed));
        (self.seed, self.steps, self.push, self.pushed, self.end) = (seed, 0, None, false, None);
        self.see();
    }

    /// Lets another policy go on.
    pub(super) fn set_policy(&mut self, policy: Greedy) {
        self.policy = policy;
        self.see();
    }

    fn see(&mut self) {
        self.action = self.policy.act(&self.observation);
        self.q_values = [0, 1].map(|action| self.policy.q_value(0, action) as f32);
    }

    /// Replaces the policy's action by this one for the next [`PUSH_STEPS`] steps.
    pub(super) fn push(&mut self, action: usize) {
        self.push = Some((action, PUSH_STEPS));
        self.pushed = true;
    }

    /// One step; none after the end.
    pub(super) fn step(&mut self) {
        if self.end.is_some() {
            return;
        }
        let action = self.push.map_or(self.action, |(action, _)| action);
        self.push = self.push.filter(|&(_, left)| left > 1).map(|(action, left)| (action, left - 1));
        let step = self.environment.step(action);
        self.observation = step.observation;
        self.steps += 1;
        self.see();
        if step.ended() {
            self.returns.push((self.steps, self.pushed));
            self.end = Some(step);
        }
    }

    /// x, ẋ, θ, θ̇
    pub(super) fn state(&self) -> [f64; 4] {
        self.observation.map(f64::from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trainer::evaluate;
    use crate::view::tests::policy;

    fn play_on(player: &mut Player) -> u64 {
        while player.end.is_none() {
            player.step();
        }
        player.steps
    }

    #[test]
    fn plays_the_episodes_that_an_evaluation_plays() {
        let expected = evaluate(&policy(), &CartPole::v1(), 7, 3);
        let mut player = Player::new(Greedy::new(policy(), 1), 7);
        for (seed, expected) in (7..).zip(expected) {
            player.start(seed);
            assert_eq!(play_on(&mut player) as f64, expected);
        }
        assert_eq!(player.returns.len(), 3);
        assert!(player.returns.iter().all(|(_, pushed)| !pushed));
    }

    #[test]
    fn q_values_are_in_raw_rewards_and_the_scale_changes_no_action() {
        let mut plain = Player::new(Greedy::new(policy(), 1), 7);
        let mut scaled = Player::new(Greedy::new(policy(), 1).with_reward_scale(0.25), 7);
        while plain.end.is_none() {
            assert_eq!(scaled.q_values, plain.q_values.map(|q| 4.0 * q));
            assert_eq!(scaled.action, plain.action);
            plain.step();
            scaled.step();
        }
    }

    #[test]
    fn a_push_is_three_actions_of_the_one_who_pushes() {
        let [mut free, mut pushed] = [(); 2].map(|()| Player::new(Greedy::new(policy(), 1), 7));
        for player in [&mut free, &mut pushed] {
            (0..10).for_each(|_| player.step());
        }
        pushed.push(1);
        for left in [2, 1] {
            pushed.step();
            assert_eq!(pushed.push, Some((1, left)));
        }
        pushed.step();
        assert_eq!(pushed.push, None);
        // 3 × 0.02 s × 10 N against 1.1 kg, and what the pole adds.
        let gained = pushed.state()[1] - {
            (0..3).for_each(|_| free.step());
            free.state()[1]
        };
        assert!(gained > 0.1, "{gained}");
        play_on(&mut pushed);
        assert!(pushed.returns[0].1, "the return is marked");
        pushed.start(8);
        assert!(!pushed.pushed);
    }
}

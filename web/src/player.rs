//! The episode that the page shows.

use cartpole_dqn::agent::{Actor, Greedy};
use cartpole_dqn::env::catalogue::EnvironmentId;
use cartpole_dqn::env::{CartPole, Environment, Start};
use cartpole_dqn::run::{Checkpoint, SavedPolicy};
use serde_json::json;

/// What a blow to the cart adds to its velocity, in m/s.
const PUSH: f64 = 0.5;
/// What it takes from an upright pole's angular velocity per m/s of the cart, in rad/s: 1 / (4/3 · half the length), as the
/// pole turns about its axle.
const POLE_RECOIL: f64 = 1.5;

/// The [`Spec`](cartpole_dqn::env::Spec) of CartPole-v1 as JSON, with the mean return of random pushes and the distance from
/// the middle, in m, at which the track ends.
pub fn task() -> Result<Vec<u8>, String> {
    let mut task =
        serde_json::to_value(EnvironmentId::CartPoleV1.spec()).map_err(|error| error.to_string())?;
    task["random_return"] = EnvironmentId::CartPoleV1.random_return().into();
    task["max_position"] = CartPole::MAX_POSITION.into();
    Ok(task.to_string().into_bytes())
}

/// A cart and a pole under a greedy policy. No time limit ends the episode.
pub struct Player {
    pub policy: SavedPolicy,
    environment: CartPole,
    observation: Vec<f32>,
    steps: u64,
}

impl Player {
    /// A cart in the middle with an upright pole.
    pub fn new(policy: SavedPolicy) -> Self {
        let environment = CartPole::default();
        let observation = vec![0.0; environment.spec().observation_size];
        Self { policy, environment, observation, steps: 0 }
    }

    /// The policy in the bytes of a checkpoint, and a description of it as JSON.
    pub fn load(bytes: &[u8]) -> Result<(SavedPolicy, Vec<u8>), String> {
        let checkpoint = Checkpoint::from_bytes(bytes).map_err(|problem| problem.to_string())?;
        let environment = CartPole::default();
        let policy =
            SavedPolicy::of(&checkpoint, environment.spec()).map_err(|problem| problem.to_string())?;
        let header = policy.header.as_ref();
        let description = json!({
            "env_steps": header.map(|header| header.env_steps),
            "evaluation": header.and_then(|header| header.evaluation),
            "sha256": policy.policy.sha256(),
        });
        Ok((policy, description.to_string().into_bytes()))
    }

    /// Begins an episode from a Gymnasium seed, and describes its first moment as [`Self::step`] does.
    pub fn reset(&mut self, seed: u32) -> Result<Vec<u8>, String> {
        self.steps = 0;
        let start = Start::Seed(seed.into());
        self.environment.reset(start, &mut self.observation).map_err(|error| error.to_string())?;
        Ok(self.moment(None, false))
    }

    /// Plays one step after a blow to the cart from the left (`push` 1) or the right (−1), or none (0). Returns JSON: the
    /// state after the step, the action and the Q-values it was taken on.
    pub fn step(&mut self, push: i32) -> Result<Vec<u8>, String> {
        let &[x, x_dot, theta, theta_dot] = self.environment.state().unwrap_or_default() else {
            return Err("the cart has no state".into());
        };
        if push != 0 {
            let blow = PUSH * f64::from(push.signum());
            self.environment = CartPole::at([x, x_dot + blow, theta, theta_dot - POLE_RECOIL * blow]);
            for (value, &coordinate) in
                self.observation.iter_mut().zip(self.environment.state().into_iter().flatten())
            {
                *value = coordinate as f32;
            }
        }
        let mut greedy = self.policy.greedy(1);
        let action = greedy.act(&self.observation);
        let outcome =
            self.environment.step(action, &mut self.observation).map_err(|error| error.to_string())?;
        self.steps += 1;
        Ok(self.moment(Some((action, greedy)), outcome.terminated))
    }

    fn moment(&self, choice: Option<(usize, Greedy)>, terminated: bool) -> Vec<u8> {
        let (action, q_values) = choice.map(|(action, greedy)| (action, greedy.q_values())).unzip();
        let state = self.environment.state();
        let moment = json!({
            "steps": self.steps, "state": state, "action": action, "q_values": q_values, "terminated": terminated,
        });
        moment.to_string().into_bytes()
    }

    /// The Q-value of a push to the right minus that of a push to the left, for a cart that rests in the middle, over the
    /// plane of the task's map: `size` × `size` f32, the lowest angular velocity first and in it the leftmost angle.
    pub fn map(&self, size: usize) -> Vec<u8> {
        let size = size.clamp(2, 256);
        let axes = self.environment.spec().map.iter().flatten();
        let observation = |cell: usize| {
            let mut observation = [0.0; 4];
            for (axis, index) in axes.clone().zip([cell % size, cell / size]) {
                let (low, high) = axis.range;
                axis.write(low + (high - low) * index as f64 / (size - 1) as f64, &mut observation);
            }
            observation
        };
        let observations: Vec<[f32; 4]> = (0..size * size).map(observation).collect();
        let mut greedy = self.policy.greedy(observations.len());
        greedy.forward_batch(observations.iter().map(|observation| &observation[..]));
        let preference = |sample| (greedy.q_value(sample, 1) - greedy.q_value(sample, 0)) as f32;
        (0..observations.len()).flat_map(|sample| preference(sample).to_le_bytes()).collect()
    }
}

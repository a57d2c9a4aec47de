//! Environments for tests, and short ways to what tests look at.

use std::sync::Arc;

use cartpole_dqn::agent::{AgentConfig, Dqn, DqnConfig};
use cartpole_dqn::config::Config;
use cartpole_dqn::env::catalogue::EnvironmentId;
use cartpole_dqn::env::{CartPole, Environment, EnvironmentError, Make, Outcome, Spec, Start, TimeLimit};
use cartpole_dqn::rng::Rng;
use cartpole_dqn::run::{Checkpoint, CheckpointProblem, Header};
use cartpole_dqn::trainer::Trainer;

/// The agent of a run.
pub fn dqn(trainer: &Trainer) -> &Dqn {
    trainer.agent().as_dqn().unwrap()
}

/// The settings of a config's agent.
pub fn dqn_config(config: &mut Config) -> &mut DqnConfig {
    match &mut config.agent {
        AgentConfig::Dqn(dqn) => dqn,
        AgentConfig::QTable(_) => panic!("the agent is a table"),
    }
}

/// CartPole under a time limit, to evaluate in.
pub fn cartpole(max_steps: u32) -> Result<Box<dyn Environment>, EnvironmentError> {
    EnvironmentId::CartPoleV1.make(max_steps)
}

/// Shows what so many random steps of CartPole bring.
pub fn random_steps(steps: usize, mut take: impl FnMut([f32; 4], usize, [f32; 4], Outcome)) {
    let (mut environment, mut rng) = (CartPole::v1(), Rng::from_seed(4));
    let (mut observation, mut next_observation) = ([0.0; 4], [0.0; 4]);
    environment.reset(Start::Stream(&mut rng), &mut observation).unwrap();
    for _ in 0..steps {
        let action = rng.below(2) as usize;
        let outcome = environment.step(action, &mut next_observation).unwrap();
        take(observation, action, next_observation, outcome);
        observation = next_observation;
        if outcome.ended() {
            environment.reset(Start::Stream(&mut rng), &mut observation).unwrap();
        }
    }
}

/// A checkpoint of a run with this config, as a file has it.
pub fn bytes_of(config: &Config, trainer: &Trainer) -> Vec<u8> {
    Checkpoint::of_run(config, trainer.snapshot()).unwrap().to_bytes().unwrap()
}

/// The run that a checkpoint was taken of.
pub fn resumed(config: &Config, make: Arc<Make>, bytes: &[u8]) -> Result<Trainer, CheckpointProblem> {
    let checkpoint = Checkpoint::from_bytes(bytes)?;
    let progress = checkpoint.header::<Header>()?.progress.ok_or(CheckpointProblem::NotResumable)?;
    Ok(config.make_trainer_in(make).unwrap().resume(progress, &checkpoint.tensors)?)
}

/// Two states and three actions. The action with the state's number costs nothing, the others cost 1 and 2, so every return
/// is negative or 0. The environment truncates its own episodes after ten steps, and terminates no episode.
pub struct TwoStates {
    spec: Spec,
    state: usize,
    steps: u32,
    /// Whether the start does not follow from the stream alone.
    is_random: bool,
    resets: usize,
}

impl TwoStates {
    pub fn new(is_random: bool) -> Self {
        let spec = Spec {
            id: "TwoStates".into(),
            observation_size: 2,
            num_actions: 3,
            max_steps: 100,
            solved_return: Some(-0.5),
            return_range: (-20.0, 0.0),
            steps_per_second: 1.0,
            actions: ["stay", "switch", "pay"].map(String::from).into(),
            observations: ["first", "second"].map(String::from).into(),
            mirror: None,
            map: None,
        };
        Self { spec, state: 0, steps: 0, is_random, resets: 0 }
    }

    pub fn make() -> Arc<Make> {
        Arc::new(|max_steps| Ok(Box::new(TimeLimit::new(Self::new(false), max_steps))))
    }

    fn observe(&self, observation: &mut [f32]) {
        observation.copy_from_slice(&[self.state as f32, 1.0 - self.state as f32]);
    }
}

impl Environment for TwoStates {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Result<(), EnvironmentError> {
        self.state = start.draw(|rng| rng.below(2)) as usize;
        if self.is_random {
            self.state = self.resets % 2;
            self.resets += 1;
        }
        self.steps = 0;
        self.observe(observation);
        Ok(())
    }

    fn step(&mut self, action: usize, observation: &mut [f32]) -> Result<Outcome, EnvironmentError> {
        let reward = match action {
            2 => -2.0,
            action if action == self.state => 0.0,
            _ => -1.0,
        };
        self.state = (self.state + action) % 2;
        self.steps += 1;
        self.observe(observation);
        Ok(Outcome { reward, terminated: false, truncated: self.steps == 10 })
    }
}

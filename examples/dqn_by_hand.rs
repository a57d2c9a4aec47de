//! Deep Q-learning on CartPole-v1 from the pieces of this crate, without its trainer:
//! `cargo run --release --example dqn_by_hand`
#![allow(clippy::unwrap_used)]

use cartpole_dqn::agent::{Agent, Dqn, Transition};
use cartpole_dqn::config::Config;
use cartpole_dqn::env::{CartPole, Environment, Start};
use cartpole_dqn::rng::{Rng, Stream};

fn main() {
    let config = Config::from_layers(Some(("fast.json", include_str!("../configs/fast.json"))), &[]).unwrap();
    let mut environment = CartPole::v1();
    let mirror = environment.spec().mirror.clone();
    let mut agent = Dqn::new(config.agent.as_dqn().unwrap().clone(), 4, 2, mirror.as_ref(), config.seed);
    let mut rng = Rng::spawn(config.seed, Stream::Environment);

    let (mut observation, mut next_observation) = ([0.0; 4], [0.0; 4]);
    environment.reset(Start::Stream(&mut rng), &mut observation).unwrap();
    let (mut episode, mut total) = (0, 0.0);
    for env_steps in 1..=10_000 {
        let action = agent.act(&observation);
        let outcome = environment.step(action, &mut next_observation).unwrap();
        agent.observe(Transition {
            observation: &observation,
            action,
            reward: outcome.reward as f32,
            next_observation: &next_observation,
            terminated: outcome.terminated,
            truncated: outcome.truncated,
        });
        agent.learn_if_due(env_steps).unwrap();
        observation = next_observation;
        total += outcome.reward;
        if outcome.ended() {
            println!("step {env_steps}, episode {episode}: return {total}");
            agent.end_episode(episode);
            environment.reset(Start::Stream(&mut rng), &mut observation).unwrap();
            (episode, total) = (episode + 1, 0.0);
        }
    }
}

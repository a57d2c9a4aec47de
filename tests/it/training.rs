//! Whole runs: learning, the loop, the same bits.

use cartpole_dqn::agent::{Dqn, Greedy, Policy, Transition};
use cartpole_dqn::checkpoint::{Checkpoint, weights_sha256};
use cartpole_dqn::config::Config;
use cartpole_dqn::env::{CartPole, Environment, Step, TimeLimit};
use cartpole_dqn::rng::Rng;
use cartpole_dqn::trainer::{EndReason, Event, Score, TrainError, Trainer, evaluate, play};
use serde::{Deserialize, Serialize};

/// Two states; the action with the state's number is worth 1, the other nothing. Ten steps an episode.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct TwoStates {
    state: usize,
    steps: u32,
}

impl Environment for TwoStates {
    type Observation = [f32; 2];
    const OBSERVATION_SIZE: usize = 2;
    const NUM_ACTIONS: usize = 2;
    const SOLVED_RETURN: f64 = 10.0;
    const MAX_RETURN: f64 = 10.0;

    fn reset(&mut self, rng: &mut Rng) -> [f32; 2] {
        *self = Self { state: rng.below(2) as usize, steps: 0 };
        [self.state as f32, 1.0 - self.state as f32]
    }

    fn step(&mut self, action: usize) -> Step<[f32; 2]> {
        let reward = if action == self.state { 1.0 } else { 0.0 };
        self.state = (self.state + action) % 2;
        self.steps += 1;
        let observation = [self.state as f32, 1.0 - self.state as f32];
        Step { observation, reward, terminated: self.steps == 10, truncated: false }
    }

    fn state(&self) -> &[f64] {
        &[]
    }
}

/// The default config with changes; one of a whole group replaces the changes before it in that group.
fn config(sets: &[&str]) -> Config {
    let mut kept: Vec<&str> = Vec::new();
    for set in sets {
        if let Some((group, _)) = set.split_once("={") {
            kept.retain(|earlier| !earlier.starts_with(&format!("{group}.")));
        }
        kept.push(set);
    }
    let sets: Vec<String> = kept.iter().map(ToString::to_string).collect();
    Config::from_layers(None, &sets).unwrap()
}

const SMALL: [&str; 6] = [
    "network.hidden=[16]",
    "replay.warmup_steps=50",
    "exploration.steps=500",
    "target.every_steps=50",
    "budget.steps=1500",
    "evaluation.every_steps=500",
];

#[test]
fn learns_a_trivial_environment() {
    let mut events: Vec<Event> = Vec::new();
    let mut trainer = Trainer::new(config(&SMALL), TwoStates::default());
    trainer.run(&mut events, None).unwrap();
    let last = trainer.progress().last_evaluation.unwrap();
    assert_eq!(last.mean, 10.0, "{events:?}");
}

#[test]
fn every_kind_of_target_and_update_learns_it_too() {
    for extra in [
        &["target={\"kind\":\"none\"}"][..],
        &["target={\"kind\":\"hard\",\"every_episodes\":3}"],
        &["replay.update=per_sample", "replay.batch_size=8", "loss=huber"],
        &["exploration={\"schedule\":\"per_episode\",\"decay\":0.95}"],
        &["learn.every_steps=4", "learn.updates=4"],
    ] {
        let mut trainer = Trainer::new(config(&[&SMALL, extra].concat()), TwoStates::default());
        trainer.run(&mut Vec::<Event>::new(), None).unwrap();
        assert_eq!(trainer.progress().best_evaluation.unwrap().mean, 10.0, "{extra:?}");
    }
}

#[test]
fn stops_when_solved_if_asked_to() {
    let mut trainer =
        Trainer::new(config(&[&SMALL[..], &["stop_when_solved=true"]].concat()), TwoStates::default());
    assert_eq!(trainer.run(&mut Vec::<Event>::new(), None).unwrap(), EndReason::Solved);
    assert_eq!(trainer.progress().solved_at_step, Some(trainer.progress().env_steps));
}

#[test]
fn a_budget_of_episodes_counts_episodes() {
    let config = config(&["budget.episodes=7", "network.hidden=[8]"]);
    let mut events: Vec<Event> = Vec::new();
    let mut trainer = Trainer::new(config, CartPole::v1());
    trainer.run(&mut events, None).unwrap();
    let lengths: Vec<u64> = events
        .iter()
        .filter_map(|event| if let Event::Episode { length, .. } = event { Some(*length) } else { None })
        .collect();
    assert_eq!(lengths.len(), 7);
    assert_eq!(lengths.iter().sum::<u64>(), trainer.progress().env_steps);
}

#[test]
fn a_run_that_diverges_names_the_step() {
    let sets = ["optimizer.learning_rate=1", "optimizer.beta1=0", "optimizer.beta2=0", "gamma=1"];
    let extra = ["exploration.final=1", "target={\"kind\":\"none\"}", "optimizer.epsilon=1e-30"];
    let mut config = config(&[&sets[..], &extra].concat());
    config.optimizer.learning_rate = 1e30;
    let mut trainer = Trainer::new(config, CartPole::v1());
    let error = trainer.run(&mut Vec::<Event>::new(), None).unwrap_err();
    let TrainError::Diverged { env_steps, .. } = error else { panic!("{error}") };
    assert_eq!(env_steps, trainer.progress().env_steps);
    assert!(error.to_string().contains(&format!("environment step {env_steps}")), "{error}");
}

/// Keras' loop in the tutorial: act, step, store, learn; after episode e: ε × decay, copy if e % 10 == 0.
#[test]
fn the_tutorials_schedules_are_followed() {
    let config = config(&[
        "target.every_episodes=10",
        "exploration={\"schedule\":\"per_episode\",\"initial\":1,\"final\":0.9,\"decay\":0.99}",
    ]);
    let mut agent = Dqn::new(config.dqn(), 4, 2, 0);
    let mut epsilon = 1.0;
    for episode in 0..25 {
        agent.online.parameters_mut()[0] = episode as f32 + 100.0;
        agent.after_step(episode + 1);
        agent.after_episode(episode);
        epsilon = if epsilon > 0.9 { epsilon * 0.99 } else { epsilon };
        assert_eq!(agent.epsilon, epsilon);
        let last_copy = (episode / 10 * 10) as f32 + 100.0;
        assert_eq!(agent.target.parameters()[0], last_copy, "after episode {episode}");
    }
}

#[test]
fn only_termination_zeroes_the_bootstrap_unless_truncation_is_terminal() {
    for (truncation_is_terminal, expected) in [(false, false), (true, true)] {
        let set = format!("truncation_is_terminal={truncation_is_terminal}");
        let mut agent = Dqn::new(config(&[&set]).dqn(), 1, 2, 0);
        let (observation, next_observation) = ([0.0], [1.0]);
        agent.observe(Transition {
            observation: &observation,
            action: 0,
            reward: 1.0,
            next_observation: &next_observation,
            terminated: false,
            truncated: true,
        });
        let mut minibatch = cartpole_dqn::agent::Minibatch::new(1, 1);
        agent.replay.gather(&[0], &mut minibatch);
        assert_eq!(minibatch.terminated, [expected]);
        assert_eq!(minibatch.next_observations[(0, 0)], 1.0);
    }
}

#[test]
fn explores_with_probability_epsilon() {
    let mut agent = Dqn::new(config(&["exploration.final=1"]).dqn(), 4, 2, 0);
    let acts = |agent: &mut Dqn| (0..4000).filter(|_| agent.act(&[0.1, 0.2, 0.3, 0.4]) == 0).count();
    agent.epsilon = 0.0;
    let greedy = acts(&mut agent);
    assert!(greedy == 0 || greedy == 4000);
    agent.epsilon = 0.5;
    let share = acts(&mut agent) as f64 / 4000.0;
    assert!((share - if greedy == 0 { 0.25 } else { 0.75 }).abs() < 0.03, "{share}");
}

fn smoke(seed: u64) -> Trainer<TimeLimit<CartPole>> {
    let text = include_str!("../../configs/smoke.json");
    let config = Config::from_layers(Some(("smoke.json", text)), &[format!("seed={seed}")]).unwrap();
    Trainer::new(config, CartPole::v1())
}

/// Debug and release builds, every instruction set and every CPU must give these weights. A change of this value is
/// a change of every result, and has to be justified.
#[test]
fn smoke_run_gives_the_committed_weights() {
    let mut trainer = smoke(1);
    trainer.run(&mut Vec::<Event>::new(), None).unwrap();
    assert_eq!(weights_sha256(&trainer.agent().online), include_str!("../data/smoke_weights.sha256").trim());
}

#[test]
fn a_seed_is_a_run_and_another_seed_another() {
    let run = |seed| {
        let mut events: Vec<Event> = Vec::new();
        let mut trainer = smoke(seed);
        trainer.run(&mut events, None).unwrap();
        (events, trainer.checkpoint().unwrap().to_bytes().unwrap())
    };
    assert!(run(5) == run(5));
    let (five, six) = (run(5), run(6));
    assert!(five.0 != six.0 && five.1 != six.1);
}

#[test]
fn a_run_resumed_in_mid_episode_goes_on_with_the_same_bits() {
    for extra in [
        &[][..],
        &["target={\"kind\":\"hard\",\"every_episodes\":2}", "replay.capacity=300"],
        &[
            "replay.update=per_sample",
            "exploration={\"schedule\":\"per_episode\"}",
            "budget={\"episodes\":40}",
        ],
    ] {
        let sets = ["network.hidden=[12, 8]", "replay.warmup_steps=100", "budget.steps=900"];
        let config =
            config(&[&sets, &["evaluation.every_steps=350", "evaluation.episodes=2"][..], extra].concat());
        let mut whole = Trainer::new(config.clone(), CartPole::v1());
        let mut events: Vec<Event> = Vec::new();
        whole.run(&mut events, None).unwrap();

        let mut first = Trainer::new(config, CartPole::v1());
        let mut parts: Vec<Event> = Vec::new();
        for _ in 0..411 {
            first.step(&mut parts, None).unwrap();
        }
        let bytes = first.checkpoint().unwrap().to_bytes().unwrap();
        drop(first);
        let mut second = Trainer::resume(&Checkpoint::from_bytes(&bytes).unwrap(), CartPole::v1()).unwrap();
        assert_eq!(second.checkpoint().unwrap().to_bytes().unwrap(), bytes);
        second.run(&mut parts, None).unwrap();
        assert_eq!(parts, events, "{extra:?}");
        let bytes = |trainer: &Trainer<_>| trainer.checkpoint().unwrap().to_bytes().unwrap();
        assert!(bytes(&second) == bytes(&whole), "{extra:?}");
    }
}

#[test]
fn an_evaluation_is_repeatable_and_leaves_the_training_alone() {
    let network = smoke(3).agent().online.clone();
    let returns = evaluate(&network, &CartPole::v1(), 42, 5);
    assert_eq!(evaluate(&network, &CartPole::v1(), 44, 3), returns[2..]);

    let run = |every: &str| {
        let sets = ["network.hidden=[8]", "budget.steps=1300", "evaluation.episodes=3", every];
        let mut trainer = Trainer::new(config(&sets), CartPole::v1());
        trainer.run(&mut Vec::<Event>::new(), None).unwrap();
        weights_sha256(&trainer.agent().online)
    };
    assert_eq!(run("evaluation.every_steps=1000"), run("evaluation.every_steps=100"));
}

#[test]
fn episodes_in_lockstep_are_the_episodes_one_by_one() {
    let mut trainer = smoke(2);
    trainer.run(&mut Vec::<Event>::new(), None).unwrap();
    let network = &trainer.agent().online;
    let mut policy = Greedy::new(network.clone(), 1);
    let one_by_one: Vec<f64> = (0..150)
        .map(|episode| play(&mut policy, CartPole::v1(), 9 + episode, |_| Ok::<_, ()>(())).unwrap())
        .collect();
    assert_eq!(evaluate(network, &CartPole::v1(), 9, 150), one_by_one);
    assert!(one_by_one.iter().any(|&value| value != one_by_one[0]), "episodes of several lengths");
}

#[test]
fn scores_are_numpys() {
    let score = Score::new(&[1.0, 2.0, 4.0, 9.0]);
    // numpy: mean 4, std 3.082207001484488, median 3
    assert_eq!((score.mean, score.median, score.min, score.max), (4.0, 3.0, 1.0, 9.0));
    assert!((score.std - 3.082_207_001_484_488).abs() < 1e-12);
    assert!((score.interval().unwrap() - 1.96 * 3.559_026_084_010_437 / 2.0).abs() < 1e-12);
    assert!(!Score::new(&[500.0; 99]).solves(475.0) && Score::new(&[500.0; 100]).solves(475.0));
    assert_eq!(Score::new(&[7.0]).interval(), None);
}

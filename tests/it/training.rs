//! Whole runs: learning, the loop, the same bits.

use std::sync::atomic::{AtomicBool, Ordering};

use cartpole_dqn::agent::{Dqn, Greedy, NotFinite, Policy, Probes, Transition};
use cartpole_dqn::checkpoint::{Checkpoint, weights_sha256};
use cartpole_dqn::config::Config;
use cartpole_dqn::env::{CartPole, Environment, Step, TimeLimit};
use cartpole_dqn::rng::Rng;
use cartpole_dqn::trainer::{EndReason, Event, EventSink, Score, TrainError, Trainer, evaluate, play};
use serde::{Deserialize, Serialize};

/// A run that nobody stops.
static NEVER: AtomicBool = AtomicBool::new(false);

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
    trainer.run(&mut events, None, &NEVER).unwrap();
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
        &["double=true"],
        &["n_step=3"],
        &["target={\"kind\":\"soft\",\"tau\":0.05}"],
        &["target={\"kind\":\"soft\",\"tau\":0.05}", "policy_weights=target"],
        &["optimizer.max_gradient_norm=1"],
        &["optimizer.schedule.steps=1500"],
        &["reward_scale=0.1"],
    ] {
        let mut config = config(&[&SMALL, extra].concat());
        // The observations of this environment have another size than the config's.
        config.observation_divisors = Some(vec![2.0, 0.5]).filter(|_| extra == ["reward_scale=0.1"]);
        let mut trainer = Trainer::new(config, TwoStates::default());
        trainer.run(&mut Vec::<Event>::new(), None, &NEVER).unwrap();
        assert_eq!(trainer.progress().best_evaluation.unwrap().mean, 10.0, "{extra:?}");
    }
}

#[test]
fn stops_when_solved_if_asked_to() {
    let mut trainer =
        Trainer::new(config(&[&SMALL[..], &["stop_when_solved=true"]].concat()), TwoStates::default());
    assert_eq!(trainer.run(&mut Vec::<Event>::new(), None, &NEVER).unwrap(), EndReason::Solved);
    assert_eq!(trainer.progress().solved_at_step, Some(trainer.progress().env_steps));
}

#[test]
fn a_budget_of_episodes_counts_episodes() {
    let config = config(&["budget.episodes=7", "network.hidden=[8]"]);
    let mut events: Vec<Event> = Vec::new();
    let mut trainer = Trainer::new(config, CartPole::v1());
    trainer.run(&mut events, None, &NEVER).unwrap();
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
    let error = trainer.run(&mut Vec::<Event>::new(), None, &NEVER).unwrap_err();
    let TrainError::Diverged { env_steps, .. } = error else { panic!("{error}") };
    assert_eq!(env_steps, trainer.progress().env_steps);
    assert!(error.to_string().contains(&format!("environment step {env_steps}")), "{error}");
}

/// Hidden units of 1e-36 and weights of 1e38 behind them: the Q-values are 600, the first layer's gradient overflows.
#[test]
fn a_loss_a_gradient_and_a_weight_that_leave_the_finite_are_told_apart() {
    let mut agent = experienced(&[]);
    agent.online.layer_mut(0).fill(0.0);
    agent.online.layer_mut(0)[4 * 6..].fill(1e-36);
    agent.online.layer_mut(1)[..6 * 2].fill(1e38);
    assert_eq!(agent.learn(), Err(NotFinite::Gradient));

    let mut agent = experienced(&[]);
    agent.online.parameters_mut().fill(1e20);
    assert_eq!(agent.learn(), Err(NotFinite::Loss));

    let mut agent = experienced(&[]);
    agent.adam.learning_rate = 1e300;
    assert_eq!(agent.learn(), Err(NotFinite::Weight));
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

/// An agent that has seen 40 steps of CartPole.
fn experienced(sets: &[&str]) -> Dqn {
    let small = ["network.hidden=[6]", "replay.batch_size=8", "replay.warmup_steps=8"];
    let mut agent = Dqn::new(config(&[&small, sets].concat()).dqn(), 4, 2, 3);
    let mut environment = CartPole::v1();
    let mut rng = Rng::from_seed(4);
    let mut observation = environment.reset(&mut rng);
    for _ in 0..40 {
        let action = rng.below(2) as usize;
        let step = environment.step(action);
        agent.observe(Transition {
            observation: &observation,
            action,
            reward: step.reward,
            next_observation: &step.observation,
            terminated: step.terminated,
            truncated: step.truncated,
        });
        observation = if step.ended() { environment.reset(&mut rng) } else { step.observation };
    }
    agent
}

#[test]
fn a_soft_target_follows_after_every_learning_step() {
    let mut agent = experienced(&["target={\"kind\":\"soft\",\"tau\":0.25}", "learn.updates=3"]);
    for _ in 0..3 {
        let before = agent.target.clone();
        agent.learn().unwrap();
        for ((&target, &before), &online) in
            agent.target.parameters().iter().zip(before.parameters()).zip(agent.online.parameters())
        {
            assert_eq!(target, 0.25_f32.mul_add(online - before, before));
        }
    }
    assert_ne!(agent.target, agent.online);
}

#[test]
fn double_targets_differ_only_where_the_networks_disagree() {
    let (mut plain, mut double) = (experienced(&[]), experienced(&["double=true"]));
    assert_eq!(plain.learn(), double.learn(), "both networks are the same at the start");
    assert_eq!(plain.online, double.online);
    for agent in [&mut plain, &mut double] {
        agent.target.parameters_mut().iter_mut().for_each(|parameter| *parameter = -*parameter);
    }
    assert!(double.learn().unwrap() != plain.learn().unwrap());
}

#[test]
fn a_schedule_sets_the_learning_rate_by_environment_steps() {
    let mut agent = experienced(&["optimizer.schedule.steps=100", "optimizer.learning_rate=0.5"]);
    assert_eq!(agent.adam.learning_rate, 0.5);
    for (env_steps, expected) in [(25, 0.375), (50, 0.25), (100, 0.0), (1000, 0.0)] {
        agent.after_step(env_steps);
        assert_eq!(agent.adam.learning_rate, expected);
    }
    let before = agent.online.clone();
    agent.learn().unwrap();
    assert_eq!(agent.online, before, "a learning rate of 0 changes nothing");
}

/// The first moment after one step of Adam is a tenth of the gradient.
#[test]
fn a_gradient_is_clipped_before_adam_sees_it() {
    let norm = |sets: &[&str]| {
        let mut agent = experienced(sets);
        agent.learn().unwrap();
        agent.adam.first_moment.iter().map(|&m| f64::from(m).powi(2)).sum::<f64>().sqrt() / 0.1
    };
    let free = norm(&[]);
    assert!(free > 0.2);
    assert!((norm(&["optimizer.max_gradient_norm=0.125"]) - 0.125).abs() < 1e-5);
    assert_eq!(norm(&["optimizer.max_gradient_norm=1e9"]), free);
}

#[test]
fn observations_and_rewards_are_scaled_once_and_folded_out_of_the_policy() {
    let scale = [2.0, 4.0, 0.25, 0.5];
    let plain = experienced(&[]);
    let mut scaled = experienced(&["observation_divisors=[2,4,0.25,0.5]", "reward_scale=0.25"]);
    let (plain, stored) = (plain.replay.contents(), scaled.replay.contents());
    for (stored, raw) in stored.observations.chunks_exact(4).zip(plain.observations.chunks_exact(4)) {
        for coordinate in 0..4 {
            assert_eq!(stored[coordinate], raw[coordinate] / scale[coordinate]);
        }
    }
    assert!(stored.rewards.iter().all(|&reward| reward == 0.25));

    // Powers of two: both ways round alike.
    let mut policy = cartpole_dqn::agent::Greedy::new(scaled.policy(), 1).with_reward_scale(0.25);
    scaled.epsilon = -1.0;
    for observation in plain.observations.chunks_exact(4) {
        assert_eq!(scaled.act(observation), policy.act(observation));
        assert_eq!(scaled.q_values(), policy.q_values());
    }
    assert_ne!(scaled.policy(), scaled.online);
}

#[test]
fn the_policy_is_made_of_the_chosen_weights() {
    let soft = "target={\"kind\":\"soft\"}";
    for (weights, of_target) in [("policy_weights=online", false), ("policy_weights=target", true)] {
        let mut agent = experienced(&[soft, weights]);
        agent.learn().unwrap();
        let expected = if of_target { &agent.target } else { &agent.online };
        assert_eq!(agent.policy(), *expected);
    }
    let sets =
        [soft, "policy_weights=target", "budget.steps=300", "replay.warmup_steps=100", "network.hidden=[8]"];
    let mut trainer = Trainer::new(config(&sets), CartPole::v1());
    trainer.run(&mut Vec::<Event>::new(), None, &NEVER).unwrap();
    let checkpoint = trainer.checkpoint().unwrap();
    assert_eq!(checkpoint.policy(4, 2).unwrap(), trainer.agent().target);
    assert_eq!(trainer.best_checkpoint().unwrap().unwrap().policy(4, 2).unwrap(), trainer.agent().target);
    let mut online = trainer.agent().target.clone();
    checkpoint.get_network("online.", &mut online).unwrap();
    assert_eq!(online, trainer.agent().online);
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
        agent.replay.gather(&[0], 1, 0.9, &mut minibatch);
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
    trainer.run(&mut Vec::<Event>::new(), None, &NEVER).unwrap();
    assert_eq!(weights_sha256(&trainer.agent().online), include_str!("../data/smoke_weights.sha256").trim());
}

#[test]
fn a_seed_is_a_run_and_another_seed_another() {
    let run = |seed| {
        let mut events: Vec<Event> = Vec::new();
        let mut trainer = smoke(seed);
        trainer.run(&mut events, None, &NEVER).unwrap();
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
        &["double=true", "n_step=4", "replay.capacity=300", "optimizer.schedule.steps=700"],
        &["target={\"kind\":\"soft\",\"tau\":0.01}", "policy_weights=target", "learn.every_steps=3"],
        &["optimizer.max_gradient_norm=0.5", "observation_divisors=[2.4,2,0.2095,2]", "reward_scale=0.01"],
    ] {
        let sets = ["network.hidden=[12, 8]", "replay.warmup_steps=100", "budget.steps=900"];
        let config =
            config(&[&sets, &["evaluation.every_steps=350", "evaluation.episodes=2"][..], extra].concat());
        let mut whole = Trainer::new(config.clone(), CartPole::v1());
        let mut events: Vec<Event> = Vec::new();
        whole.run(&mut events, None, &NEVER).unwrap();

        let mut first = Trainer::new(config, CartPole::v1());
        let mut parts: Vec<Event> = Vec::new();
        for _ in 0..411 {
            first.step(&mut parts, None).unwrap();
        }
        let bytes = first.checkpoint().unwrap().to_bytes().unwrap();
        drop(first);
        let mut second = Trainer::resume(&Checkpoint::from_bytes(&bytes).unwrap(), CartPole::v1()).unwrap();
        assert_eq!(second.checkpoint().unwrap().to_bytes().unwrap(), bytes);
        second.run(&mut parts, None, &NEVER).unwrap();
        assert_eq!(parts, events, "{extra:?}");
        let bytes = |trainer: &Trainer<_>| trainer.checkpoint().unwrap().to_bytes().unwrap();
        assert!(bytes(&second) == bytes(&whole), "{extra:?}");
    }
}

/// Sets the flag with the event of the given number.
struct StopsAt<'a>(&'a AtomicBool, usize, Vec<Event>);

impl EventSink for StopsAt<'_> {
    fn emit(&mut self, event: &Event) -> std::io::Result<()> {
        let Self(stop, number, events) = self;
        events.push(event.clone());
        stop.fetch_or(events.len() == *number, Ordering::Relaxed);
        Ok(())
    }
}

#[test]
fn a_stopped_run_leaves_a_checkpoint_of_that_step_and_goes_on_from_there() {
    let mut events: Vec<Event> = Vec::new();
    smoke(1).run(&mut events, None, &NEVER).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for number in [1, 30, events.len() - 10] {
        let stop = AtomicBool::new(false);
        let mut sink = StopsAt(&stop, number, Vec::new());
        let mut trainer = smoke(1);
        assert_eq!(trainer.run(&mut sink, Some(folder.path()), &stop).unwrap(), EndReason::Interrupted);
        let StopsAt(.., mut parts) = sink;
        assert!(parts.len() < events.len());
        let checkpoint = Checkpoint::read(&folder.path().join("last.safetensors")).unwrap();
        let mut resumed = Trainer::resume(&checkpoint, CartPole::v1()).unwrap();
        assert_eq!(resumed.progress(), trainer.progress());
        resumed.run(&mut parts, None, &NEVER).unwrap();
        assert_eq!(parts, events);
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
        trainer.run(&mut Vec::<Event>::new(), None, &NEVER).unwrap();
        weights_sha256(&trainer.agent().online)
    };
    assert_eq!(run("evaluation.every_steps=1000"), run("evaluation.every_steps=100"));
}

#[test]
fn episodes_in_lockstep_are_the_episodes_one_by_one() {
    let mut trainer = smoke(2);
    trainer.run(&mut Vec::<Event>::new(), None, &NEVER).unwrap();
    let network = &trainer.agent().online;
    let mut policy = Greedy::new(network.clone(), 1);
    let one_by_one: Vec<f64> = (0..150)
        .map(|episode| play(&mut policy, CartPole::v1(), 9 + episode, |_| Ok::<_, ()>(())).unwrap())
        .collect();
    assert_eq!(evaluate(network, &CartPole::v1(), 9, 150), one_by_one);
    assert!(one_by_one.iter().any(|&value| value != one_by_one[0]), "episodes of several lengths");
}

#[test]
fn statistics_of_a_network_of_zeros_are_known() {
    let mut agent = Dqn::new(config(&["network.hidden=[5]", "reward_scale=0.5"]).dqn(), 4, 2, 0);
    agent.online.parameters_mut().fill(0.0);
    agent.target.copy_from(&agent.online.clone());
    for step in 0..20 {
        agent.observe(Transition {
            observation: &[0.1; 4],
            action: 1,
            reward: 3.0,
            next_observation: &[0.2; 4],
            terminated: step % 5 == 4,
            truncated: false,
        });
    }
    let probes = Probes { ordinary: vec![vec![1.0; 4]; 3], doomed: vec![vec![-1.0; 4]; 2] };
    let statistics = agent.statistics(&probes);
    assert_eq!(statistics.terminal_share, 0.2);
    assert_eq!((statistics.max_q, statistics.action_gap, statistics.doomed_max_q), (0.0, 0.0, 0.0));
    assert_eq!(statistics.td_error_quantiles, [3.0; 3]);
    // The mean of (0 - 1.5)² over the batch has the derivative -3 by the bias of action 1, and 0 by all else.
    assert!((statistics.gradient_norm - 3.0).abs() < 1e-6);
    assert_eq!(statistics.dead_relu_share, 1.0);

    // One living unit of five; Q-values 2 and 7 where the sum of the observation is positive, else 0 and 5.
    let outputs = 5;
    for input in 0..4 {
        agent.online.layer_mut(0)[input * outputs] = 0.5;
    }
    agent.online.layer_mut(1)[..2].copy_from_slice(&[1.0, 1.0]);
    agent.online.layer_mut(1)[2 * outputs..].copy_from_slice(&[0.0, 5.0]);
    let statistics = agent.statistics(&probes);
    assert_eq!((statistics.max_q, statistics.action_gap), (14.0, 10.0));
    assert_eq!((statistics.doomed_max_q, statistics.dead_relu_share), (10.0, 0.8));
}

#[test]
fn statistics_come_with_every_evaluation() {
    let mut events: Vec<Event> = Vec::new();
    smoke(4).run(&mut events, None, &NEVER).unwrap();
    let evaluations = events.iter().filter(|event| matches!(event, Event::Evaluation { .. })).count();
    let statistics: Vec<_> = events
        .iter()
        .filter_map(|event| {
            if let Event::Statistics { overestimation, agent, .. } = event {
                Some((overestimation, agent))
            } else {
                None
            }
        })
        .collect();
    assert_eq!(statistics.len(), evaluations);
    for (overestimation, agent) in statistics {
        assert!(overestimation.is_finite() && agent.max_q > 0.0 && agent.gradient_norm > 0.0, "{agent:?}");
        assert!((0.005..0.1).contains(&agent.terminal_share) && agent.dead_relu_share < 0.9, "{agent:?}");
    }
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

/// With full scores in every evaluation the last of them is the best: the first is that of the least trained policy.
#[test]
fn the_best_policy_is_the_latest_of_equals() {
    let mut events: Vec<Event> = Vec::new();
    let mut trainer = Trainer::new(config(&SMALL), TwoStates::default());
    trainer.run(&mut events, None, &NEVER).unwrap();
    let full: Vec<u64> = events
        .iter()
        .filter_map(|event| match event {
            Event::Evaluation { env_steps, mean: 10.0, best, .. } => {
                assert!(best);
                Some(*env_steps)
            }
            _ => None,
        })
        .collect();
    assert!(full.len() > 1, "{events:?}");
    assert_eq!(trainer.progress().best_evaluation.unwrap().env_steps, *full.last().unwrap());
    assert_eq!(*trainer.best_policy().unwrap(), trainer.agent().policy());
}

/// Under a limit of 900 steps an episode may be longer than 500, and still no score is.
#[test]
fn a_longer_time_limit_is_seen_in_training_and_in_no_score() {
    let text = include_str!("../../configs/fast.json");
    let sets = ["max_episode_steps=900".to_owned(), "budget.steps=6000".to_owned()];
    let config = Config::from_layers(Some(("fast.json", text)), &sets).unwrap();
    let environment = config.make_environment();
    let mut trainer = Trainer::new(config, environment);
    let mut events: Vec<Event> = Vec::new();
    trainer.run(&mut events, None, &NEVER).unwrap();
    let evaluations = events.iter().filter_map(|event| match event {
        Event::Evaluation { mean, max, mean_under_limit, solved, .. } => {
            Some((*mean, *max, *mean_under_limit, *solved))
        }
        _ => None,
    });
    let long: Vec<_> = evaluations.filter(|(.., under_limit, _)| under_limit.is_some()).collect();
    assert!(!long.is_empty(), "{events:?}");
    for (mean, max, under_limit, solved) in long {
        assert!(
            mean <= 500.0 && max == 500.0 && under_limit.unwrap() > mean && under_limit.unwrap() <= 900.0
        );
        assert_eq!(solved, mean >= 475.0);
    }
}

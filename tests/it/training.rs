//! Whole runs: learning, the loop, the same bits.

use std::sync::atomic::{AtomicBool, Ordering};

use cartpole_dqn::agent::{
    Actor, Agent, Counters, Dqn, Minibatch, NamedNumbers, NotFinite, Played, Policy, Probes, Transition,
};
use cartpole_dqn::config::Config;
use cartpole_dqn::env::{CartPole, Environment, EnvironmentError, Outcome, Spec, Start};
use cartpole_dqn::rng::{Rng, Stream};
use cartpole_dqn::tensors::weights_sha256;
use cartpole_dqn::trainer::{
    CheckpointKind, DueCheckpoint, EVALUATION_SEED, EndReason, Event, LASTING_EPISODES, LASTING_EPSILON,
    Observer, Score, Snapshot, TrainError, Trainer, evaluate, lasts, record,
};

use super::plain;
use super::tasks::{TwoStates, bytes_of, cartpole, dqn, dqn_config, random_steps, resumed};

/// A run that nobody stops.
static NEVER: AtomicBool = AtomicBool::new(false);

/// Plain DQN with changes; one of a whole group replaces the changes before it in that group.
fn config(sets: &[&str]) -> Config {
    let mut kept: Vec<&str> = Vec::new();
    for set in sets {
        if let Some((group, _)) = set.split_once("={") {
            kept.retain(|earlier| !earlier.starts_with(&format!("{group}.")));
        }
        kept.push(set);
    }
    let sets: Vec<String> = kept.iter().map(ToString::to_string).collect();
    plain(&sets)
}

const SMALL: [&str; 6] = [
    "network.hidden=[16]",
    "replay.warmup_steps=50",
    "exploration.steps=500",
    "target.every_steps=50",
    "budget.steps=1500",
    "evaluation.every_steps=500",
];

fn two_states(config: &Config) -> Trainer {
    config.make_trainer_in(TwoStates::make()).unwrap()
}

fn trainer(config: &Config) -> Trainer {
    config.make_trainer().unwrap()
}

fn network(policy: &Policy) -> &cartpole_dqn::nn::Mlp<f32> {
    policy.network().unwrap()
}

#[test]
fn learns_a_trivial_environment() {
    let mut events: Vec<Event> = Vec::new();
    let mut trainer = two_states(&config(&SMALL));
    trainer.run(&mut events, &NEVER).unwrap();
    let last = trainer.progress().last_evaluation.unwrap();
    assert_eq!(last.mean, 0.0, "{events:?}");
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
        dqn_config(&mut config).observation_divisors =
            Some(vec![2.0, 0.5]).filter(|_| extra == ["reward_scale=0.1"]);
        let mut trainer = two_states(&config);
        trainer.run(&mut Vec::<Event>::new(), &NEVER).unwrap();
        assert_eq!(trainer.progress().best_evaluation.unwrap().mean, 0.0, "{extra:?}");
    }
}

#[test]
fn stops_when_solved_if_asked_to() {
    let mut trainer = two_states(&config(&[&SMALL[..], &["stop_when_solved=true"]].concat()));
    assert_eq!(trainer.run(&mut Vec::<Event>::new(), &NEVER).unwrap(), EndReason::Solved);
    assert_eq!(trainer.progress().solved_at_step, Some(trainer.progress().env_steps));
}

/// The policy and the mean return of every evaluation.
#[derive(Default)]
struct Evaluated(Vec<Policy>, Vec<f64>);

impl Observer for Evaluated {
    fn event(&mut self, event: &Event) -> std::io::Result<()> {
        if let Event::Evaluation { mean, .. } = *event {
            self.1.push(mean);
        }
        Ok(())
    }
    fn policy(&mut self, policy: &Policy) {
        self.0.push(policy.clone());
    }
}

/// Beside a plain search: the first evaluation that solves the task like the one before it, with a policy of which no
/// episode terminates although some actions are random.
#[test]
fn a_run_ends_with_the_first_policy_that_lasts_if_asked_to() {
    let text = include_str!("../../configs/cartpole.json");
    let lasts_plainly = |policy: &Policy| {
        let mut actor = policy.greedy(1);
        (EVALUATION_SEED..EVALUATION_SEED + LASTING_EPISODES).all(|seed| {
            let (mut environment, mut observation) = (cartpole(3000).unwrap(), [0.0; 4]);
            environment.reset(Start::Seed(seed), &mut observation).unwrap();
            let mut rng = Rng::spawn(seed, Stream::Explore);
            loop {
                let random = seed % 2 == 1 && rng.unit() <= LASTING_EPSILON;
                let action = if random { rng.below(2) as usize } else { actor.act(&observation) };
                let outcome = environment.step(action, &mut observation).unwrap();
                if outcome.ended() {
                    break !outcome.terminated;
                }
            }
        })
    };
    let (mut failed_the_test, mut lasting) = (0, 0);
    for seed in 0..6 {
        let run = |limit: &str| {
            let sets = [format!("seed={seed}"), "budget.steps=6000".into(), limit.into()];
            let mut trainer = trainer(&Config::from_layers(Some(("cartpole.json", text)), &sets).unwrap());
            let mut evaluated = Evaluated::default();
            let reason = trainer.run(&mut evaluated, &NEVER).unwrap();
            (trainer, evaluated, reason)
        };
        let (_, Evaluated(policies, means), _) = run("stop_when_lasting_steps=null");
        let solve = |k: usize| means[k - 1] >= 475.0 && means[k] >= 475.0;
        let first = (1..means.len()).find(|&k| solve(k) && lasts_plainly(&policies[k]));
        lasting += usize::from(first.is_some());
        failed_the_test += (1..first.unwrap_or(means.len())).filter(|&k| solve(k)).count();

        let (trainer, evaluated, reason) = run("stop_when_lasting_steps=3000");
        let (expected, evaluations) =
            first.map_or((EndReason::Budget, means.len()), |k| (EndReason::Lasting, k + 1));
        assert_eq!((reason, evaluated.1.len()), (expected, evaluations), "seed {seed}");
        assert_eq!(trainer.progress().env_steps, 500 * evaluations as u64);
        assert_eq!(evaluated.1[..], means[..evaluations], "the run before its end is the same");
    }
    assert!(
        failed_the_test > 0 && lasting > 0,
        "{failed_the_test} policies fail the test, {lasting} runs pass it"
    );
}

/// CartPole as a program in three processes would be played.
struct InProcesses(Box<dyn Environment>);

impl Environment for InProcesses {
    fn spec(&self) -> &Spec {
        self.0.spec()
    }
    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Result<(), EnvironmentError> {
        self.0.reset(start, observation)
    }
    fn step(&mut self, action: usize, observation: &mut [f32]) -> Result<Outcome, EnvironmentError> {
        self.0.step(action, observation)
    }
    fn processes(&self) -> Option<usize> {
        Some(3)
    }
}

#[test]
fn a_policy_lasts_or_not_in_any_number_of_processes() {
    let text = include_str!("../../configs/cartpole.json");
    let sets = ["seed=21".to_owned(), "stop_when_lasting_steps=2000".into()];
    let mut trainer = trainer(&Config::from_layers(Some(("cartpole.json", text)), &sets).unwrap());
    let mut evaluated = Evaluated::default();
    assert_eq!(trainer.run(&mut evaluated, &NEVER).unwrap(), EndReason::Lasting);
    let in_processes = |steps: u32| -> Result<Box<dyn Environment>, EnvironmentError> {
        Ok(Box::new(InProcesses(cartpole(steps)?)))
    };
    for policy in &evaluated.0 {
        let (here, _) = lasts(policy, &cartpole, 2000).unwrap();
        assert_eq!(lasts(policy, &in_processes, 2000).unwrap().0, here);
    }
    // The run counts what its tests played: of every policy that solves the task like the one before it.
    let Evaluated(policies, means) = &evaluated;
    let tested = (1..means.len()).filter(|&k| means[k - 1] >= 475.0 && means[k] >= 475.0);
    let played: u64 = tested.map(|k| lasts(&policies[k], &cartpole, 2000).unwrap().1).sum();
    assert_eq!(trainer.progress().lasting_test_steps, played);
    assert_eq!(trainer.progress().evaluation_steps, (20.0 * means.iter().sum::<f64>()).round() as u64);
    assert_eq!(lasts(evaluated.0.last().unwrap(), &cartpole, 2000).unwrap(), (true, 100 * 2000));
    let (first, played) = lasts(&evaluated.0[0], &cartpole, 2000).unwrap();
    assert!(!first && played < 100 * 2000);
}

/// Nothing in this task terminates, and no policy of it lasts before two evaluations in a row have solved it.
#[test]
fn a_policy_that_solves_the_task_once_does_not_end_the_run() {
    let mut trainer = two_states(&config(&[&SMALL[..], &["stop_when_lasting_steps=10"]].concat()));
    assert_eq!(trainer.run(&mut Vec::<Event>::new(), &NEVER).unwrap(), EndReason::Lasting);
    let solved_at_step = trainer.progress().solved_at_step.unwrap();
    assert!(trainer.progress().env_steps >= solved_at_step + 500);

    // The environment cuts its episodes off after ten steps: nothing lasts eleven.
    let mut trainer = two_states(&config(&[&SMALL[..], &["stop_when_lasting_steps=11"]].concat()));
    assert_eq!(trainer.run(&mut Vec::<Event>::new(), &NEVER).unwrap(), EndReason::Budget);
}

#[test]
fn a_budget_of_episodes_counts_episodes() {
    let config = config(&["budget.episodes=7", "network.hidden=[8]"]);
    let mut events: Vec<Event> = Vec::new();
    let mut trainer = trainer(&config);
    trainer.run(&mut events, &NEVER).unwrap();
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
    dqn_config(&mut config).optimizer.learning_rate = 1e30;
    let mut trainer = trainer(&config);
    let error = trainer.run(&mut Vec::<Event>::new(), &NEVER).unwrap_err();
    let TrainError::Diverged { env_steps, .. } = error else { panic!("{error}") };
    assert_eq!(env_steps, trainer.progress().env_steps);
    assert!(error.to_string().contains(&format!("environment step {env_steps}")), "{error}");
}

/// Hidden units of 1e-36 and weights of 1e38 behind them: the Q-values are 600, the first layer's gradient overflows.
#[test]
fn a_loss_a_gradient_and_a_weight_that_leave_the_finite_are_told_apart() {
    let mut agent = experienced(&[]);
    agent.online.mlp.layer_mut(0).fill(0.0);
    agent.online.mlp.layer_mut(0)[4 * 6..].fill(1e-36);
    agent.online.mlp.layer_mut(1)[..6 * 2].fill(1e38);
    assert_eq!(agent.learn(), Err(NotFinite::Gradient));

    let mut agent = experienced(&[]);
    agent.online.mlp.parameters_mut().fill(1e20);
    assert_eq!(agent.learn(), Err(NotFinite::Loss));

    let mut agent = experienced(&[]);
    agent.adam.learning_rate = 1e300;
    assert_eq!(agent.learn(), Err(NotFinite::Weight));
}

/// Of a number that has left the finite, the next learning step must not say that its mean loss is NaN.
#[test]
fn a_learning_step_after_one_that_failed_fails_too() {
    for mode in ["minibatch", "per_sample"] {
        let mut agent = experienced(&[&format!("replay.update={mode}")]);
        agent.online.mlp.parameters_mut().fill(1e20);
        for _ in 0..3 {
            assert_eq!(agent.learn(), Err(NotFinite::Loss), "{mode}");
        }
    }
}

/// Keras' loop in the tutorial: act, step, store, learn; after episode e: ε × decay, copy if e % 10 == 0.
#[test]
fn the_tutorials_schedules_are_followed() {
    let config = config(&[
        "target.every_episodes=10",
        "exploration={\"schedule\":\"per_episode\",\"initial\":1,\"final\":0.9,\"decay\":0.99}",
    ]);
    let mut agent = Dqn::new(config.agent.as_dqn().unwrap().clone(), 4, 2, None, 0);
    let mut epsilon = 1.0;
    for episode in 0..25 {
        agent.online.mlp.parameters_mut()[0] = episode as f32 + 100.0;
        agent.learn_if_due(episode + 1).unwrap();
        agent.end_episode(episode);
        epsilon = if epsilon > 0.9 { epsilon * 0.99 } else { epsilon };
        assert_eq!(agent.exploration.epsilon, epsilon);
        let last_copy = (episode / 10 * 10) as f32 + 100.0;
        assert_eq!(agent.target.mlp.parameters()[0], last_copy, "after episode {episode}");
    }
}

/// An agent that has seen 40 steps of CartPole.
fn experienced(sets: &[&str]) -> Dqn {
    let small = ["network.hidden=[6]", "replay.batch_size=8", "replay.warmup_steps=8"];
    let mut agent = Dqn::new(config(&[&small, sets].concat()).agent.as_dqn().unwrap().clone(), 4, 2, None, 3);
    random_steps(40, |observation, action, next_observation, outcome| {
        agent.observe(Transition {
            observation: &observation,
            action,
            reward: outcome.reward as f32,
            next_observation: &next_observation,
            terminated: outcome.terminated,
            truncated: outcome.truncated,
        });
    });
    agent
}

#[test]
fn a_soft_target_follows_after_every_learning_step() {
    let mut agent = experienced(&["target={\"kind\":\"soft\",\"tau\":0.25}", "learn.updates=3"]);
    for _ in 0..3 {
        let before = agent.target.mlp.clone();
        agent.learn().unwrap();
        for ((&target, &before), &online) in
            agent.target.mlp.parameters().iter().zip(before.parameters()).zip(agent.online.mlp.parameters())
        {
            assert_eq!(target, 0.25_f32.mul_add(online - before, before));
        }
    }
    assert_ne!(agent.target.mlp, agent.online.mlp);
}

#[test]
fn double_targets_differ_only_where_the_networks_disagree() {
    let (mut plain, mut double) = (experienced(&[]), experienced(&["double=true"]));
    assert_eq!(plain.learn(), double.learn(), "both networks are the same at the start");
    assert_eq!(plain.online.mlp, double.online.mlp);
    for agent in [&mut plain, &mut double] {
        agent.target.mlp.parameters_mut().iter_mut().for_each(|parameter| *parameter = -*parameter);
    }
    assert!(double.learn().unwrap() != plain.learn().unwrap());
}

#[test]
fn a_schedule_sets_the_learning_rate_by_environment_steps() {
    let mut agent = experienced(&["optimizer.schedule.steps=100", "optimizer.learning_rate=0.5"]);
    assert_eq!(agent.adam.learning_rate, 0.5);
    for (env_steps, expected) in [(25, 0.375), (50, 0.25), (100, 0.0), (1000, 0.0)] {
        agent.learn_if_due(env_steps).unwrap();
        assert_eq!(agent.counters().learning_rate, expected);
    }
    let before = agent.online.mlp.clone();
    agent.learn().unwrap();
    assert_eq!(agent.online.mlp, before, "a learning rate of 0 changes nothing");
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
    let mut policy = scaled.policy().greedy(1);
    scaled.exploration.epsilon = -1.0;
    for observation in plain.observations.chunks_exact(4) {
        assert_eq!(scaled.act(observation), policy.act(observation));
    }
    assert_ne!(*scaled.policy().network().unwrap(), scaled.online.mlp);
}

#[test]
fn the_policy_is_made_of_the_chosen_weights() {
    let soft = "target={\"kind\":\"soft\"}";
    for (weights, of_target) in [("policy_weights=online", false), ("policy_weights=target", true)] {
        let mut agent = experienced(&[soft, weights]);
        agent.learn().unwrap();
        let expected = if of_target { &agent.target.mlp } else { &agent.online.mlp };
        assert_eq!(agent.policy().network().unwrap(), expected);
    }
    let sets =
        [soft, "policy_weights=target", "budget.steps=300", "replay.warmup_steps=100", "network.hidden=[8]"];
    let mut trainer = trainer(&config(&sets));
    trainer.run(&mut Vec::<Event>::new(), &NEVER).unwrap();
    let Snapshot { tensors, .. } = trainer.snapshot();
    assert_eq!(tensors.network(4, 2).unwrap(), dqn(&trainer).target.mlp);
    assert_eq!(network(trainer.best_policy().unwrap()), &dqn(&trainer).target.mlp);
    let mut online = dqn(&trainer).target.mlp.clone();
    tensors.get_network("online.", &mut online).unwrap();
    assert_eq!(online, dqn(&trainer).online.mlp);
}

#[test]
fn only_termination_zeroes_the_bootstrap_unless_truncation_is_terminal() {
    for (truncation_is_terminal, expected) in [(false, false), (true, true)] {
        let set = format!("truncation_is_terminal={truncation_is_terminal}");
        let mut agent = Dqn::new(config(&[&set]).agent.as_dqn().unwrap().clone(), 1, 2, None, 0);
        let (observation, next_observation) = ([0.0], [1.0]);
        agent.observe(Transition {
            observation: &observation,
            action: 0,
            reward: 1.0,
            next_observation: &next_observation,
            terminated: false,
            truncated: true,
        });
        let mut minibatch = Minibatch::new(1, 1);
        agent.replay.gather(&[0], 1, 0.9, &mut minibatch);
        assert_eq!(minibatch.terminated, [expected]);
        assert_eq!(minibatch.next_observations[(0, 0)], 1.0);
    }
}

#[test]
fn explores_with_probability_epsilon() {
    let mut agent = Dqn::new(config(&["exploration.final=1"]).agent.as_dqn().unwrap().clone(), 4, 2, None, 0);
    let acts = |agent: &mut Dqn| (0..4000).filter(|_| agent.act(&[0.1, 0.2, 0.3, 0.4]) == 0).count();
    agent.exploration.epsilon = 0.0;
    let greedy = acts(&mut agent);
    assert!(greedy == 0 || greedy == 4000);
    agent.exploration.epsilon = 0.5;
    let share = acts(&mut agent) as f64 / 4000.0;
    assert!((share - if greedy == 0 { 0.25 } else { 0.75 }).abs() < 0.03, "{share}");
}

fn smoke_config(seed: u64) -> Config {
    let text = include_str!("../../configs/smoke.json");
    Config::from_layers(Some(("smoke.json", text)), &[format!("seed={seed}")]).unwrap()
}

fn smoke(seed: u64) -> Trainer {
    trainer(&smoke_config(seed))
}

/// Debug and release builds, every instruction set and every CPU must give these weights. A change of this value is
/// a change of every result, and has to be justified.
#[test]
fn smoke_run_gives_the_committed_weights() {
    let mut trainer = smoke(1);
    trainer.run(&mut Vec::<Event>::new(), &NEVER).unwrap();
    assert_eq!(
        weights_sha256(&dqn(&trainer).online.mlp),
        include_str!("../data/smoke_weights.sha256").trim()
    );
}

#[test]
fn a_seed_is_a_run_and_another_seed_another() {
    let run = |seed| {
        let mut events: Vec<Event> = Vec::new();
        let mut trainer = smoke(seed);
        trainer.run(&mut events, &NEVER).unwrap();
        (events, bytes_of(&smoke_config(seed), &trainer))
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
            "exploration={\"schedule\":\"per_episode\",\"repeat\":9}",
            "budget={\"episodes\":40}",
        ],
        &["double=true", "n_step=4", "replay.capacity=300", "optimizer.schedule.steps=700"],
        &["target={\"kind\":\"soft\",\"tau\":0.01}", "policy_weights=target", "learn.every_steps=3"],
        &["exploration.final=1", "exploration.repeat=1000"],
        &["optimizer.max_gradient_norm=0.5", "observation_divisors=[2.4,2,0.2095,2]", "reward_scale=0.01"],
    ] {
        let sets = ["network.hidden=[12, 8]", "replay.warmup_steps=100", "budget.steps=900"];
        let config =
            config(&[&sets, &["evaluation.every_steps=350", "evaluation.episodes=2"][..], extra].concat());
        let mut whole = trainer(&config);
        let mut events: Vec<Event> = Vec::new();
        whole.run(&mut events, &NEVER).unwrap();

        let mut first = trainer(&config);
        let mut parts: Vec<Event> = Vec::new();
        for _ in 0..411 {
            first.step(&mut parts).unwrap();
        }
        let bytes = bytes_of(&config, &first);
        drop(first);
        let mut second = resumed(&config, config.make(), &bytes).unwrap();
        assert_eq!(bytes_of(&config, &second), bytes);
        second.run(&mut parts, &NEVER).unwrap();
        assert_eq!(parts, events, "{extra:?}");
        assert!(bytes_of(&config, &second) == bytes_of(&config, &whole), "{extra:?}");
    }
}

/// Sets the flag with the event of the given number, and keeps the latest checkpoint of the run.
struct StopsAt<'a> {
    stop: &'a AtomicBool,
    number: usize,
    events: Vec<Event>,
    last: Option<Snapshot>,
}

impl Observer for StopsAt<'_> {
    fn event(&mut self, event: &Event) -> std::io::Result<()> {
        self.events.push(event.clone());
        self.stop.fetch_or(self.events.len() == self.number, Ordering::Relaxed);
        Ok(())
    }

    fn checkpoint(&mut self, checkpoint: &DueCheckpoint<'_>) -> std::io::Result<()> {
        if let CheckpointKind::Last { .. } = checkpoint.kind {
            self.last = Some(checkpoint.snapshot());
        }
        Ok(())
    }
}

#[test]
fn a_stopped_run_leaves_a_checkpoint_of_that_step_and_goes_on_from_there() {
    let mut events: Vec<Event> = Vec::new();
    smoke(1).run(&mut events, &NEVER).unwrap();
    for number in [1, 30, events.len() - 10] {
        let stop = AtomicBool::new(false);
        let mut observer = StopsAt { stop: &stop, number, events: Vec::new(), last: None };
        let mut trainer = smoke(1);
        assert_eq!(trainer.run(&mut observer, &stop).unwrap(), EndReason::Interrupted);
        let StopsAt { events: mut parts, last, .. } = observer;
        assert!(parts.len() < events.len());
        let Snapshot { progress, tensors, .. } = last.unwrap();
        let mut resumed = smoke(1).resume(progress.unwrap(), &tensors).unwrap();
        assert_eq!(resumed.progress(), trainer.progress());
        resumed.run(&mut parts, &NEVER).unwrap();
        assert_eq!(parts, events);
    }
}

#[test]
fn an_evaluation_is_repeatable_and_leaves_the_training_alone() {
    let policy = smoke(3).agent().policy();
    let evaluated = |seed, episodes| evaluate(&policy, &cartpole, 500, seed, episodes, 1.0).unwrap();
    assert_eq!(evaluated(44, 3), evaluated(42, 5)[2..]);

    let run = |every: &str| {
        let sets = ["network.hidden=[8]", "budget.steps=1300", "evaluation.episodes=3", every];
        let mut trainer = trainer(&config(&sets));
        trainer.run(&mut Vec::<Event>::new(), &NEVER).unwrap();
        weights_sha256(&dqn(&trainer).online.mlp)
    };
    assert_eq!(run("evaluation.every_steps=1000"), run("evaluation.every_steps=100"));
}

#[test]
fn episodes_in_lockstep_are_the_episodes_one_by_one() {
    let mut trainer = smoke(2);
    trainer.run(&mut Vec::<Event>::new(), &NEVER).unwrap();
    let policy = trainer.agent().policy();
    let mut actor = policy.greedy(1);
    let one_by_one: Vec<f64> =
        (0..150).map(|episode| record(&mut actor, &mut CartPole::v1(), 9 + episode).unwrap().total).collect();
    let played = evaluate(&policy, &cartpole, 500, 9, 150, 1.0).unwrap();
    assert_eq!(played.iter().map(|episode| episode.total).collect::<Vec<_>>(), one_by_one);
    assert!(played.iter().all(|episode| episode.total == episode.steps as f64));
    assert!(one_by_one.iter().any(|&value| value != one_by_one[0]), "episodes of several lengths");
}

#[test]
fn statistics_of_a_network_of_zeros_are_known() {
    let mut agent = Dqn::new(
        config(&["network.hidden=[5]", "reward_scale=0.5"]).agent.as_dqn().unwrap().clone(),
        4,
        2,
        None,
        0,
    );
    agent.online.mlp.parameters_mut().fill(0.0);
    agent.target.mlp.copy_from(&agent.online.mlp.clone());
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
    let played = [Played { expected: 2.0, discounted: 1.5, ..Played::default() }];
    let number = |agent: &Dqn, name: &str| {
        let numbers = agent.statistics(&probes, &played).unwrap();
        numbers.get(name).unwrap_or_else(|| panic!("{name}: {numbers:?}"))
    };
    assert_eq!(number(&agent, "terminal_share"), 0.2);
    for name in ["max_q", "action_gap", "doomed_max_q"] {
        assert_eq!(number(&agent, name), 0.0);
    }
    for name in ["td_error_q10", "td_error_q50", "td_error_q90"] {
        assert_eq!(number(&agent, name), 3.0);
    }
    // 2 / 0.5 - 1.5
    assert_eq!(number(&agent, "overestimation"), 2.5);
    // The mean of (0 - 1.5)² over the batch has the derivative -3 by the bias of action 1, and 0 by all else.
    assert!((number(&agent, "gradient_norm") - 3.0).abs() < 1e-6);
    assert_eq!(number(&agent, "dead_relu_share"), 1.0);

    // One living unit of five; Q-values 2 and 7 where the sum of the observation is positive, else 0 and 5.
    let outputs = 5;
    for input in 0..4 {
        agent.online.mlp.layer_mut(0)[input * outputs] = 0.5;
    }
    agent.online.mlp.layer_mut(1)[..2].copy_from_slice(&[1.0, 1.0]);
    agent.online.mlp.layer_mut(1)[2 * outputs..].copy_from_slice(&[0.0, 5.0]);
    assert_eq!((number(&agent, "max_q"), number(&agent, "action_gap")), (14.0, 10.0));
    assert_eq!((number(&agent, "doomed_max_q"), number(&agent, "dead_relu_share")), (10.0, 0.8));
}

#[test]
fn statistics_come_with_every_evaluation() {
    let mut events: Vec<Event> = Vec::new();
    smoke(4).run(&mut events, &NEVER).unwrap();
    let evaluations = events.iter().filter(|event| matches!(event, Event::Evaluation { .. })).count();
    let statistics: Vec<_> = events
        .iter()
        .filter_map(|event| if let Event::Statistics { numbers, .. } = event { Some(numbers) } else { None })
        .collect();
    assert_eq!(statistics.len(), evaluations);
    for numbers in statistics {
        let number = |name| numbers.get(name).unwrap();
        assert!(number("overestimation").is_finite() && number("max_q") > 0.0, "{numbers:?}");
        assert!(number("gradient_norm") > 0.0 && number("dead_relu_share") < 0.9, "{numbers:?}");
        assert!((0.005..0.1).contains(&number("terminal_share")), "{numbers:?}");
    }
}

#[test]
fn scores_are_numpys() {
    let score = Score::new(&[1.0, 2.0, 4.0, 9.0]);
    // numpy: mean 4, std 3.082207001484488, median 3
    assert_eq!((score.mean, score.median, score.min, score.max), (4.0, 3.0, 1.0, 9.0));
    assert!((score.std - 3.082_207_001_484_488).abs() < 1e-12);
    assert!((score.interval().unwrap() - 1.96 * 3.559_026_084_010_437 / 2.0).abs() < 1e-12);
    assert_eq!(Score::new(&[7.0]).interval(), None);
}

/// With full scores in every evaluation the last of them is the best: the first is that of the least trained policy.
#[test]
fn the_best_policy_is_the_latest_of_equals() {
    let mut events: Vec<Event> = Vec::new();
    let mut trainer = two_states(&config(&SMALL));
    trainer.run(&mut events, &NEVER).unwrap();
    let full: Vec<u64> = events
        .iter()
        .filter_map(|event| match event {
            Event::Evaluation { env_steps, mean: 0.0, best, .. } => {
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

/// Under a limit of 900 steps a training episode may be longer than 500, and still no score is.
#[test]
fn a_longer_time_limit_is_seen_in_training_and_in_no_score() {
    let text = include_str!("../../configs/fast.json");
    let sets =
        ["max_episode_steps=900", "budget.steps=6000", "stop_when_lasting_steps=null"].map(String::from);
    let config = Config::from_layers(Some(("fast.json", text)), &sets).unwrap();
    let mut events: Vec<Event> = Vec::new();
    trainer(&config).run(&mut events, &NEVER).unwrap();
    let lengths = events.iter().filter_map(|event| match event {
        Event::Episode { length, .. } => Some(*length),
        _ => None,
    });
    let longest = lengths.max().unwrap();
    assert!(longest > 500 && longest <= 900, "{longest}");
    for event in &events {
        if let Event::Evaluation { max, mean, solved, .. } = event {
            assert!(*max <= 500.0 && *solved == (*mean >= 475.0));
        }
    }
}

/// A run of an environment with three actions, negative returns and its own truncation goes through a checkpoint.
#[test]
fn an_environment_of_any_size_and_sign_is_trained_and_resumed() {
    let config = config(&[&SMALL[..], &["max_episode_steps=7"]].concat());
    let mut events: Vec<Event> = Vec::new();
    let mut whole = two_states(&config);
    whole.run(&mut events, &NEVER).unwrap();
    assert!(
        events
            .iter()
            .any(|event| matches!(event, Event::Episode { length: 7, return_, .. } if *return_ < 0.0))
    );
    // Evaluations have the environment's own limits.
    assert!(
        whole.progress().solved_at_step.is_some() && whole.progress().best_evaluation.unwrap().mean == 0.0
    );

    let mut first = two_states(&config);
    let mut parts: Vec<Event> = Vec::new();
    (0..633).for_each(|_| first.step(&mut parts).unwrap());
    let mut second = resumed(&config, TwoStates::make(), &bytes_of(&config, &first)).unwrap();
    second.run(&mut parts, &NEVER).unwrap();
    assert_eq!(parts, events);
    assert!(bytes_of(&config, &second) == bytes_of(&config, &whole));
}

#[test]
fn an_environment_that_is_not_deterministic_is_noticed_when_its_run_is_resumed() {
    let config = config(&SMALL);
    let random = || -> std::sync::Arc<cartpole_dqn::env::Make> {
        std::sync::Arc::new(|_| Ok(Box::new(TwoStates::new(true))))
    };
    let refused = |steps: usize| {
        let mut trainer = config.make_trainer_in(random()).unwrap();
        (0..steps).for_each(|_| trainer.step(&mut Vec::<Event>::new()).unwrap());
        resumed(&config, random(), &bytes_of(&config, &trainer)).err().map(|error| error.to_string())
    };
    let errors: Vec<String> = [13, 24, 35].into_iter().filter_map(refused).collect();
    assert!(
        !errors.is_empty() && errors.iter().all(|error| error.contains("not deterministic")),
        "{errors:?}"
    );
}

/// What the trainer asks of its agent, in which order.
struct Recording(std::sync::Arc<std::sync::Mutex<Vec<&'static str>>>, Dqn);

impl Recording {
    fn note(&self, call: &'static str) {
        self.0.lock().unwrap().push(call);
    }
}

impl Agent for Recording {
    fn act(&mut self, observation: &[f32]) -> usize {
        self.note("act");
        self.1.act(observation)
    }
    fn observe(&mut self, transition: Transition<'_>) {
        self.note("observe");
        self.1.observe(transition);
    }
    fn learn_if_due(&mut self, env_steps: u64) -> Result<Option<f32>, NotFinite> {
        self.note("learn");
        self.1.learn_if_due(env_steps)
    }
    fn end_episode(&mut self, episode: u64) {
        self.note("end of episode");
        self.1.end_episode(episode);
    }
    fn policy(&self) -> Policy {
        self.note("policy");
        self.1.policy()
    }
    fn start_from(&mut self, policy: &Policy) -> bool {
        self.1.start_from(policy)
    }
    fn gamma(&self) -> f64 {
        self.1.gamma()
    }
    fn counters(&self) -> Counters {
        self.1.counters()
    }
    fn statistics(&self, probes: &Probes, played: &[Played]) -> Option<NamedNumbers> {
        self.note("statistics");
        self.1.statistics(probes, played)
    }
    fn weights_sha256(&self) -> String {
        self.1.weights_sha256()
    }
    fn save(&self, tensors: &mut cartpole_dqn::tensors::Tensors) {
        self.1.save(tensors);
    }
    fn load(
        &mut self, tensors: &cartpole_dqn::tensors::Tensors, env_steps: u64,
    ) -> Result<(), cartpole_dqn::tensors::TensorError> {
        self.1.load(tensors, env_steps)
    }
}

#[test]
fn an_agent_acts_observes_learns_and_ends_its_episode_before_it_is_evaluated() {
    let config = config(&[&SMALL[..], &["evaluation.every_steps=10", "budget.steps=51"]].concat());
    let calls = std::sync::Arc::default();
    let agent = Recording(
        std::sync::Arc::clone(&calls),
        Dqn::new(config.agent.clone().as_dqn().unwrap().clone(), 2, 3, None, 0),
    );
    let mut trainer = Trainer::new(config.trainer(), |_| Box::new(agent), TwoStates::make()).unwrap();
    (0..11).for_each(|_| trainer.step(&mut Vec::<Event>::new()).unwrap());
    let step = ["act", "observe", "learn"];
    let mut expected = step.repeat(10);
    expected.extend(["end of episode", "policy", "statistics"].iter().chain(&step));
    assert_eq!(*calls.lock().unwrap(), expected);
}

#[test]
fn the_documents_explain_every_statistic_as_the_table_does() {
    let documented = include_str!("../../docs/metrics.md");
    for known in cartpole_dqn::agent::STATISTICS {
        let row = format!("| `{}` | {} |\n", known.name, known.meaning);
        assert!(documented.contains(&row), "not in docs/metrics.md: {row}");
    }
}

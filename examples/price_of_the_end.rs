//! What it costs to end a run with a policy that lasts: the steps of training, of evaluations, and of the test of
//! `stop_when_lasting_steps`, of which the agent learns nothing. The default config, for the seeds A to B − 1:
//! `cargo run --release --example price_of_the_end -- A B`
#![allow(clippy::unwrap_used, clippy::panic)]

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use cartpole_dqn::config::Config;
use cartpole_dqn::env::catalogue::EnvironmentId;
use cartpole_dqn::env::{Environment, EnvironmentError, Outcome, Spec, Start};
use cartpole_dqn::trainer::Event;

/// Steps by the time limit of their episodes. Training, evaluations and the test each have a limit of their own.
type Steps = Arc<Mutex<BTreeMap<u32, u64>>>;

struct Counted {
    environment: Box<dyn Environment>,
    max_steps: u32,
    steps: Steps,
}

impl Environment for Counted {
    fn spec(&self) -> &Spec {
        self.environment.spec()
    }

    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Result<(), EnvironmentError> {
        self.environment.reset(start, observation)
    }

    fn step(&mut self, action: usize, observation: &mut [f32]) -> Result<Outcome, EnvironmentError> {
        *self.steps.lock().unwrap().entry(self.max_steps).or_default() += 1;
        self.environment.step(action, observation)
    }
}

fn main() {
    let seeds: Vec<u64> = std::env::args().skip(1).map(|seed| seed.parse().unwrap()).collect();
    let [first, end] = seeds[..] else { panic!("the first seed and the one after the last") };
    let file = ("cartpole.json", include_str!("../configs/cartpole.json"));
    let mut runs: Vec<[u64; 3]> = Vec::new();
    for seed in first..end {
        let config = Config::from_layers(Some(file), &[format!("seed={seed}")]).unwrap();
        let limits =
            [config.max_episode_steps, Some(500), config.stop_when_lasting_steps].map(Option::unwrap);
        let steps = Steps::default();
        let counted = Arc::clone(&steps);
        let make = move |max_steps| {
            let environment = EnvironmentId::CartPoleV1.make(max_steps)?;
            Ok(Box::new(Counted { environment, max_steps, steps: Arc::clone(&counted) })
                as Box<dyn Environment>)
        };
        let mut trainer = config.make_trainer_in(Arc::new(make)).unwrap();
        trainer.run(&mut Vec::<Event>::new(), &AtomicBool::new(false)).unwrap();
        let steps = steps.lock().unwrap();
        runs.push(limits.map(|limit| steps.get(&limit).copied().unwrap_or(0)));
        println!("seed {seed}: {:?} steps of training, evaluations, test", runs[runs.len() - 1]);
    }
    let median = |of: usize| {
        let mut sorted: Vec<u64> = runs.iter().map(|run| run[of]).collect();
        sorted.sort_unstable();
        sorted[(sorted.len() - 1) / 2]
    };
    println!("median: {:?}", [median(0), median(1), median(2)]);
}

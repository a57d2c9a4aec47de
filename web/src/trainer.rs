//! The run that is trained.

use std::io;
use std::sync::atomic::AtomicBool;

use cartpole_dqn::config::Config;
use cartpole_dqn::nn::kernels::InstructionSet;
use cartpole_dqn::run::{Checkpoint, Header};
use cartpole_dqn::tensors::Tensors;
use cartpole_dqn::trainer::{CheckpointKind, DueCheckpoint, EndReason, Event, Observer, Snapshot, Trainer};
use serde_json::{Value, json};

/// A run, and what has been observed of it.
pub struct Training {
    config: Config,
    trainer: Trainer,
    seen: Seen,
    /// Why the run is over, if it is.
    end: Option<EndReason>,
}

/// Keeps the events since the page last asked, and the latest checkpoints.
#[derive(Default)]
struct Seen {
    events: Vec<Event>,
    best: Option<Snapshot>,
    last: Option<Snapshot>,
}

impl Observer for Seen {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        self.events.push(event.clone());
        Ok(())
    }

    fn checkpoint(&mut self, due: &DueCheckpoint<'_>) -> io::Result<()> {
        let kept = match due.kind {
            CheckpointKind::Best => &mut self.best,
            CheckpointKind::Last { .. } => &mut self.last,
        };
        *kept = Some(due.snapshot());
        Ok(())
    }
}

impl Training {
    /// The run before its first step. `input` is JSON: `name` and `text` of a config file, and `sets`, a list of
    /// `key=value`. Also returns a description of the run as JSON.
    pub fn start(input: &[u8]) -> Result<(Self, Vec<u8>), String> {
        let input: Value = serde_json::from_slice(input).map_err(text)?;
        let string = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        let (name, file) = (string(&input["name"]), string(&input["text"]));
        let sets: Vec<String> = input["sets"].as_array().into_iter().flatten().map(string).collect();
        let config = Config::from_layers(Some((&name, &file)), &sets).map_err(text)?;
        if json!(config)["environment"] != "CartPole-v1" {
            return Err(
                "this page trains on CartPole-v1 alone; the program trains on every environment".into()
            );
        }
        config.check_memory(1)?;
        let trainer = config.make_trainer().map_err(text)?;
        let settings: Vec<Value> = config
            .settings()
            .into_iter()
            .map(|setting| json!({"path": setting.path, "value": setting.value, "allowed": setting.allowed}))
            .collect();
        let description = json!({
            "config": config,
            "text": serde_json::to_string_pretty(&config).map_err(text)?,
            "settings": settings,
            "version": env!("CARGO_PKG_VERSION"),
            "instruction_set": InstructionSet::current().name(),
        });
        let training = Self { config, trainer, seen: Seen::default(), end: None };
        Ok((training, description.to_string().into_bytes()))
    }

    /// Trains up to `steps` steps, as the command line does, and less if it comes to an evaluation, which may take long: that
    /// begins with the next call. Returns JSON: the events since the last call, as in `metrics.jsonl`, and where the run is.
    pub fn train(&mut self, steps: u32) -> Result<Vec<u8>, String> {
        let before = self.trainer.progress().env_steps;
        for trained in 0..steps {
            if trained > 0 && self.evaluates_next() {
                break;
            }
            if self.trainer.end_reason().is_some() {
                // What is left to do is the last evaluation.
                self.end = Some(self.trainer.run(&mut self.seen, &AtomicBool::new(false)).map_err(text)?);
                break;
            }
            self.trainer.step(&mut self.seen).map_err(text)?;
        }
        let (progress, agent) = (self.trainer.progress(), self.trainer.agent());
        let counters = agent.counters();
        let state = json!({
            "events": std::mem::take(&mut self.seen.events),
            "end": self.end.map(|reason| json!(reason)),
            "trained": progress.env_steps - before,
            "evaluates_next": self.evaluates_next(),
            "env_steps": progress.env_steps,
            "episodes": progress.episodes,
            "updates": progress.updates,
            "epsilon": counters.epsilon,
            "learning_rate": counters.learning_rate,
            "solved_at_step": progress.solved_at_step,
            "best_evaluation": progress.best_evaluation,
            "weights_sha256": agent.weights_sha256(),
        });
        Ok(state.to_string().into_bytes())
    }

    /// Whether the next step evaluates the policy.
    fn evaluates_next(&self) -> bool {
        let every_steps = self.trainer.config().evaluation.every_steps;
        let is_due = (self.trainer.progress().env_steps + 1).is_multiple_of(every_steps);
        self.end.is_none() && (is_due || self.trainer.end_reason().is_some())
    }

    /// Takes the run to where a checkpoint of it was taken, see [`Self::last`].
    pub fn resume(&mut self, bytes: &[u8]) -> Result<(), String> {
        let checkpoint = Checkpoint::from_bytes(bytes).map_err(text)?;
        let progress = checkpoint.header::<Header>().map_err(text)?.progress;
        let progress = progress.ok_or("it holds only a policy")?;
        let trainer = self.config.make_trainer().map_err(text)?;
        self.trainer = trainer.resume(progress, &checkpoint.tensors).map_err(text)?;
        self.trainer.save_best(&mut self.seen).map_err(text)?;
        // At the end of its budget the run does not offer this checkpoint again.
        self.seen.last = Some(self.trainer.snapshot());
        Ok(())
    }

    /// See [`super::policy`].
    pub fn policy(&self) -> Result<Vec<u8>, String> {
        let mut tensors = Tensors::default();
        self.trainer.agent().policy().save("", &mut tensors);
        let progress = self.trainer.progress();
        let (env_steps, evaluation) = (progress.env_steps, progress.last_evaluation);
        self.bytes(Snapshot { env_steps, evaluation, progress: None, tensors })
    }

    /// See [`super::last`]. A run that has ended has offered it before its last evaluation.
    pub fn last(&self) -> Result<Vec<u8>, String> {
        let last = self.seen.last.clone().filter(|_| self.end.is_some());
        self.bytes(last.unwrap_or_else(|| self.trainer.snapshot()))
    }

    /// See [`super::best`].
    pub fn best(&self) -> Result<Vec<u8>, String> {
        let best = self.seen.best.clone();
        self.bytes(best.ok_or("there is no best policy before the first evaluation")?)
    }

    fn bytes(&self, snapshot: Snapshot) -> Result<Vec<u8>, String> {
        Checkpoint::of_run(&self.config, snapshot).and_then(|checkpoint| checkpoint.to_bytes()).map_err(text)
    }
}

fn text(error: impl ToString) -> String {
    error.to_string()
}

//! What a run writes into its directory: events and checkpoints while it trains, and the summary at the end.

use std::io;
use std::path::{Path, PathBuf};

use super::checkpoint::MAX_FILE_SIZE;
use super::{Checkpoint, RunDir};
use crate::files::read_limited;
use crate::tensors::sha256;
use crate::trainer::{self, CheckpointKind, EndReason, Event, Observer, Summary, Trainer};

/// Keeps a run in its directory. As long as the recorder is there, no other process can change the run.
pub(crate) struct Recorder {
    pub(super) dir: RunDir,
    pub(super) config: crate::config::Config,
    /// It goes on after the events that are in them.
    pub(super) metrics: crate::sink::JsonLines,
}

impl Observer for Recorder {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        self.metrics.event(event)
    }

    fn checkpoint(&mut self, due: &trainer::DueCheckpoint<'_>) -> io::Result<()> {
        let (path, kept) = match due.kind {
            CheckpointKind::Best => (self.dir.best(), None),
            CheckpointKind::Last { keeps_previous } => {
                self.metrics.sync().map_err(|error| named(&self.dir.metrics(), &error))?;
                (self.dir.last(), keeps_previous.then(|| self.dir.previous()))
            }
        };
        let checkpoint = Checkpoint::of_run(&self.config, due.snapshot());
        let written = checkpoint
            .and_then(|checkpoint| checkpoint.write_in(self.dir.directory()?, &path, kept.as_deref()));
        written.map_err(|error| named(&path, &error))
    }
}

fn named(path: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("cannot write {}: {error}", path.display()))
}

/// `summary.json`: the summary of a run, and what it takes to repeat the run.
#[derive(serde::Serialize)]
pub(crate) struct RunRecord {
    #[serde(flatten)]
    pub(crate) summary: Summary,
    /// Mean return of the last 100 training episodes, or of as many as there are.
    pub(crate) mean_return_100: Option<f64>,
    /// Seconds of CPU of the process that ended the run, without those of an environment that is a program.
    pub(crate) cpu_seconds: Option<f64>,
    /// SHA-256 over the weights that `--init-from` gave the run; none if they were drawn.
    #[serde(skip_serializing_if = "Option::is_none")]
    init_sha256: Option<String>,
    /// SHA-256 over `config.json`; none if it is gone.
    config_sha256: Option<String>,
    version: &'static str,
    /// None where the program was not built from a clone; `-dirty` behind it if from changed files.
    git_revision: Option<&'static str>,
    cpu_path: &'static str,
}

impl RunRecord {
    /// Fields that may differ between equal runs.
    pub(crate) const CIRCUMSTANCES: [&str; 5] =
        ["wall_seconds", "cpu_seconds", "version", "git_revision", "cpu_path"];

    pub fn new(
        run: &RunDir, trainer: &Trainer, reason: EndReason, wall_seconds: f64, cpu_seconds: Option<f64>,
    ) -> Self {
        let sha256_of = |path: PathBuf| read_limited(&path, MAX_FILE_SIZE).ok().map(|bytes| sha256([bytes]));
        Self {
            summary: trainer.summary(reason, wall_seconds),
            cpu_seconds,
            mean_return_100: trainer.progress().mean_return_100(),
            init_sha256: sha256_of(run.init()),
            config_sha256: sha256_of(run.config()),
            version: env!("CARGO_PKG_VERSION"),
            git_revision: option_env!("CARTPOLE_DQN_REVISION"),
            cpu_path: crate::nn::kernels::InstructionSet::current().name(),
        }
    }
}

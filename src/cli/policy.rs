//! The policy that a command plays or describes: what the user typed, or the newest run.

use std::io::{self, IsTerminal, Read};
use std::path::{Path, PathBuf};

use clap::builder::{PossibleValuesParser, TypedValueParser};

use super::permission::AllowCommand;
use super::ui::{Failure, note};
use crate::config::EnvironmentConfig;
use crate::env::catalogue::EnvironmentId;
use crate::env::{Environment, Spec};
use crate::run::{Checkpoint, CheckpointError, CheckpointProblem, Header, SavedPolicy, checkpoint_of};
use crate::tensors::TensorError;
use crate::text::shown;

pub(super) const STANDARD: &str = "-";
/// Whether a path is standard input, under one of the names that it has.
pub(super) fn is_standard_input(path: &Path) -> bool {
    [STANDARD, "/dev/stdin", "/dev/fd/0", "/proc/self/fd/0"].iter().any(|name| path == Path::new(name))
}

/// Standard input, to which `example` sends a file.
pub(super) fn standard_input(example: &str) -> Result<io::StdinLock<'static>, Failure> {
    let stdin = io::stdin().lock();
    match stdin.is_terminal() {
        true => Err(Failure::BadInput(format!("standard input is a terminal; send a file to it: {example}"))),
        false => Ok(stdin),
    }
}

pub(super) const DEFAULT_ENVIRONMENT: EnvironmentId = EnvironmentId::CartPoleV1;

/// Where a command finds its policy.
#[derive(Debug, clap::Args)]
pub(super) struct PolicyArguments {
    /// A run (its best policy, else its last), a checkpoint, or a safetensors file of a torch.nn.Sequential; "-" is
    /// standard input [default: the newest run below runs/]
    #[arg(value_name = "PATH")]
    path: Option<PathBuf>,
    /// The same as PATH
    #[arg(long, value_name = "PATH", conflicts_with = "path")]
    checkpoint: Option<PathBuf>,
    /// What a policy that another program wrote plays; our own files say it themselves [default: CartPole-v1]
    #[arg(long, value_name = "NAME", value_parser = environment())]
    pub(super) environment: Option<EnvironmentId>,
}

fn environment() -> impl TypedValueParser<Value = EnvironmentId> {
    let unknown = || "no such environment";
    PossibleValuesParser::new(EnvironmentId::NAMES)
        .try_map(move |name| EnvironmentId::from_name(&name).ok_or_else(unknown))
}

pub(super) struct LocatedPolicy {
    /// What the user typed, or the newest run.
    pub(crate) place: PathBuf,
    pub(crate) file: PathBuf,
    pub(crate) checkpoint: Checkpoint,
    /// The environment that the policy was trained in. A program is not allowed to start yet.
    pub(crate) environment: EnvironmentConfig,
}

impl PolicyArguments {
    /// Reads the checkpoint that is meant. If the user typed nothing, a note says which run it is, unless `quiet`.
    pub(super) fn find(&self, quiet: bool) -> Result<LocatedPolicy, Failure> {
        let typed = self.path.as_ref().or(self.checkpoint.as_ref());
        let place = match typed {
            Some(place) if is_standard_input(place) => {
                let file = PathBuf::from("standard input");
                let mut stdin = standard_input("cartpole-dqn eval - < last.safetensors")?;
                let checkpoint = Checkpoint::read_from(&mut stdin as &mut dyn Read)
                    .map_err(|problem| CheckpointError { path: file.clone(), problem })?;
                return self.found(STANDARD.into(), file, checkpoint);
            }
            Some(place) => place.clone(),
            None => super::find::newest_with_policy(Path::new(super::find::RUNS))?,
        };
        if typed.is_none() && !quiet {
            note(&format!("no path is given, so this is the newest run: {}", shown(&place)));
        }
        let file = checkpoint_of(&place)?;
        let checkpoint = Checkpoint::read(&file)?;
        self.found(place, file, checkpoint)
    }

    /// The environment is the one that the checkpoint names; for a policy of another program the one that the user names.
    fn found(&self, place: PathBuf, file: PathBuf, checkpoint: Checkpoint) -> Result<LocatedPolicy, Failure> {
        let own = checkpoint.header().ok().map(|header: Header| header.config.environment);
        let typed = self.environment.map(EnvironmentConfig::Named);
        let default = EnvironmentConfig::Named(DEFAULT_ENVIRONMENT);
        let environment = own.or_else(|| typed.clone()).unwrap_or(default);
        match self.environment {
            Some(id) if typed.as_ref() != Some(&environment) => Err(Failure::BadInput(format!(
                "--environment {}: {} was trained in {}; leave --environment out",
                id.spec().id,
                shown(&file),
                environment.spec().map_or_else(|_| "a program".into(), |task| task.id)
            ))),
            _ => Ok(LocatedPolicy { place, file, checkpoint, environment }),
        }
    }
}

impl LocatedPolicy {
    pub(super) fn playable(&self, allow: AllowCommand, has_view: bool) -> Result<EnvironmentConfig, Failure> {
        let mut environment = self.environment.clone();
        let file = format!("checkpoint {}", shown(&self.file));
        allow.permit(&mut environment, &file, has_view).map_err(Failure::BadInput)?;
        Ok(environment)
    }

    pub(super) fn spec(&self) -> Result<Spec, Failure> {
        let problem = |error| Failure::BadInput(format!("checkpoint {}: {error}", shown(&self.file)));
        self.environment.spec().map_err(problem)
    }

    pub(super) fn make(&self, allow: AllowCommand, has_view: bool) -> Result<Box<dyn Environment>, Failure> {
        let make = self.playable(allow, has_view)?.make();
        Ok(make(self.spec()?.max_steps)?)
    }

    pub(super) fn policy(&self) -> Result<SavedPolicy, Failure> {
        SavedPolicy::of(&self.checkpoint, &self.spec()?).map_err(|problem| {
            use TensorError::{WrongNetwork, WrongTable};
            let is_for_another =
                matches!(problem, CheckpointProblem::Tensor(WrongNetwork { .. } | WrongTable { .. }));
            let error = CheckpointError { path: self.file.clone(), problem };
            match is_for_another && self.checkpoint.header::<Header>().is_err() {
                true => Failure::BadInput(format!("{error}; --environment NAME says what it plays")),
                false => error.into(),
            }
        })
    }
}

//! `train --init-from`: a run that starts with the weights of a policy. The run keeps a copy of them, so that it can be
//! resumed and verified without the file that they came from.

use std::path::Path;

use super::resume::Run;
use super::run_dir::RunDir;
use super::{Failure, shell_word};
use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::config::Config;
use crate::env::{CartPole, Environment};
use crate::text::shown;
use crate::trainer::Trainer;

/// Gives a run before its first step the weights of a policy; returns the copy that the run keeps.
pub(super) fn start_from(path: &Path, trainer: &mut Run) -> Result<Checkpoint, Failure> {
    let policy = Checkpoint::read(path)?
        .policy(CartPole::OBSERVATION_SIZE, CartPole::NUM_ACTIONS)
        .map_err(|problem| CheckpointError { path: path.to_owned(), problem })?;
    let (found, wanted) = (policy.sizes(), trainer.agent().online.sizes());
    if found != wanted {
        let hidden: Vec<String> = found[1..found.len() - 1].iter().map(usize::to_string).collect();
        return Err(Failure::BadInput(format!(
            "checkpoint {}: its policy has layers {found:?}, and the network of the run {wanted:?}; start from a policy \
             of that shape, or train one of this shape: --set {}",
            shown(path),
            shell_word(&format!("network.hidden=[{}]", hidden.join(",")))
        )));
    }
    let mut copy = Checkpoint::default();
    copy.put_network("", &policy);
    if trainer.start_from(&policy) {
        Ok(copy)
    } else {
        Err(Failure::BadInput(format!(
            "checkpoint {}: its weights become infinite under the run's `observation_divisors`",
            shown(path)
        )))
    }
}

/// The run of a directory before its first step, and the weights that it starts with where they are not drawn.
pub(super) fn first_step(run: &RunDir, config: Config) -> Result<(Run, Option<Checkpoint>), Failure> {
    let environment = config.make_environment();
    let mut trainer = Trainer::new(config, environment);
    let init = run.init().exists().then(|| start_from(&run.init(), &mut trainer)).transpose()?;
    Ok((trainer, init))
}

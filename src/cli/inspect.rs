//! `cartpole-dqn inspect`

use std::fmt::Write;

use clap::Args;

use super::policy::PolicyArguments;
use super::ui::{Failure, print};
use crate::agent::Policy;
use crate::env::Spec;
use crate::run::{
    Checkpoint, CheckpointError, CheckpointProblem, Header, config_of_checkpoint, final_evaluation,
};
use crate::text::{shown, visible};
use crate::trainer::Evaluation;

/// Print what is in a checkpoint: of which step it is, how it was evaluated, its policy and the hash of its weights.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn inspect runs/my-run/checkpoints/last.safetensors")]
pub(super) struct InspectArguments {
    #[command(flatten)]
    place: PolicyArguments,
    /// Print every tensor and the run's config too
    #[arg(long)]
    all: bool,
}

pub(super) fn run(arguments: &InspectArguments) -> Result<(), Failure> {
    let found = arguments.place.find(false)?;
    let mut text = describe(&found.checkpoint, &found.spec()?, arguments.all)
        .map_err(|problem| CheckpointError { path: found.file.clone(), problem })?;
    // The last checkpoint of a run of which the best is described.
    let last = final_evaluation(&found.file).map(|(_, last)| last);
    if let Some(last) = last.filter(|last| last.is_file() && *last != found.file) {
        text += &format!("not shown   {}\n", shown(&last));
    }
    print(&format!("file        {}\n{text}", shown(&found.file)))
}

fn describe(checkpoint: &Checkpoint, task: &Spec, all: bool) -> Result<String, CheckpointProblem> {
    let header = match checkpoint.header::<Header>() {
        Err(CheckpointProblem::NoHeader) => None,
        header => Some(header?),
    };
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = match &header {
        None => writeln!(text, "format      written by another program"),
        Some(header) => describe_header(&mut text, header, checkpoint.version()?),
    };
    let _ = match checkpoint.policy(task) {
        Ok(policy) => describe_policy(&mut text, checkpoint, &policy),
        Err(problem) => {
            writeln!(text, "policy      none that eval can play: {}", visible(&problem.to_string()))
        }
    };
    if !all {
        let count = checkpoint.tensors.iter().count();
        let config = if header.is_some() { " and the run's config" } else { "" };
        let _ = writeln!(text, "tensors     {count}; --all prints them{config}");
        return Ok(text);
    }
    for (name, dtype, shape) in checkpoint.tensors.iter() {
        let _ = writeln!(text, "tensor      {} {dtype:?} {shape:?}", visible(name));
    }
    if let Some(header) = &header {
        let config = serde_json::to_string_pretty(&config_of_checkpoint(&header.config)).unwrap_or_default();
        let _ = writeln!(text, "config      {}", config.replace('\n', "\n            "));
    }
    Ok(text)
}

fn describe_header(text: &mut String, header: &Header, version: Option<u32>) -> std::fmt::Result {
    let what = match header.progress {
        Some(_) => "policy and state of the run, its last",
        None => "policy of the run, its best",
    };
    writeln!(text, "format      cartpole-dqn version {}: {what}", version.unwrap_or_default())?;
    writeln!(text, "step        {} of the run (seed {})", header.env_steps, header.config.seed)?;
    let mean = |Evaluation { mean, env_steps }| format!("mean return {mean:.2} at step {env_steps}");
    writeln!(text, "evaluation  {}", header.evaluation.map_or_else(|| "none yet".into(), mean))
}

fn describe_policy(text: &mut String, checkpoint: &Checkpoint, policy: &Policy) -> std::fmt::Result {
    writeln!(text, "policy      {}", policy.shape())?;
    writeln!(text, "weights     sha256 of the policy, which eval plays:")?;
    writeln!(text, "            {}", policy.sha256())?;
    let mut online = policy.clone();
    if online.load("online.", &checkpoint.tensors).is_ok() {
        writeln!(text, "            sha256 of the online network, which train prints (weights_sha256):")?;
        writeln!(text, "            {}", online.sha256())?;
    }
    Ok(())
}

//! `cartpole-dqn inspect`

use super::ui::{Failure, print};
use crate::env::Spec;
use crate::run::{
    Checkpoint, CheckpointError, CheckpointProblem, Header, config_of_checkpoint, final_evaluation,
};
use crate::text::{shown, visible};
use crate::trainer::Evaluation;

/// Print what is in a checkpoint: of which step it is, how it was evaluated, its policy and the hash of its weights.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: cartpole-dqn inspect runs/my-run/checkpoints/last.safetensors")]
pub(super) struct InspectArguments {
    #[command(flatten)]
    place: super::policy::PolicyArguments,
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
    let mut text = match &header {
        None => "format      written by another program\n".into(),
        Some(header) => describe_header(header, checkpoint.version()?),
    };
    text += &match checkpoint.policy(task) {
        Ok(policy) => describe_policy(checkpoint, &policy),
        Err(problem) => format!("policy      none that eval can play: {}\n", visible(&problem.to_string())),
    };
    if !all {
        let count = checkpoint.tensors.iter().count();
        let config = if header.is_some() { " and the run's config" } else { "" };
        return Ok(text + &format!("tensors     {count}; --all prints them{config}\n"));
    }
    for (name, dtype, shape) in checkpoint.tensors.iter() {
        text += &format!("tensor      {} {dtype:?} {shape:?}\n", visible(name));
    }
    if let Some(header) = &header {
        let config = format!("{:#}", config_of_checkpoint(&header.config));
        text += &format!("config      {}\n", config.replace('\n', "\n            "));
    }
    Ok(text)
}

fn describe_header(header: &Header, version: Option<u32>) -> String {
    let what = match header.progress {
        Some(_) => "policy and state of the run, its last",
        None => "policy of the run, its best",
    };
    let (version, Header { env_steps, config, .. }) = (version.unwrap_or_default(), header);
    let mean = |Evaluation { mean, env_steps }| format!("mean return {mean:.2} at step {env_steps}");
    let evaluation = header.evaluation.map_or_else(|| "none yet".into(), mean);
    format!(
        "\
format      cartpole-dqn version {version}: {what}
step        {env_steps} of the run (seed {})
evaluation  {evaluation}
",
        config.seed
    )
}

fn describe_policy(checkpoint: &Checkpoint, policy: &crate::agent::Policy) -> String {
    let (shape, hash) = (policy.shape(), policy.sha256());
    let text = format!(
        "policy      {shape}\nweights     sha256 of the policy, which eval plays:\n            {hash}\n"
    );
    let mut online = policy.clone();
    if online.load("online.", &checkpoint.tensors).is_err() {
        return text;
    }
    let which = "the online network, which train prints (weights_sha256)";
    text + &format!("            sha256 of {which}:\n            {}\n", online.sha256())
}

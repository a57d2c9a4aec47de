//! `cartpole-dqn train`

use std::path::{Path, PathBuf};

use serde_json::json;

use super::permission::{AllowCommand, allowance, ask_task};
use super::signals::{self, Signals};
use super::ui::{Failure, cannot_write, check_out, note, print, print_json, program, say};
use crate::config::Config;
use crate::os::cpu_seconds;
use crate::run::{EndedRun, Recorder, Resumed, RunDir, RunRecord, Started, read_summary, resume, start};
use crate::sink::{Console, EpisodeLog, TensorBoard};
use crate::text::{shell_word, shown};
use crate::trainer::{Budget, EndReason, Evaluation, Fanout, Summary, TrainError, Trainer};
use crate::view::{Live, Pace, check_terminal};

/// Train an agent.
///
/// Writes the complete config, metrics, a summary and checkpoints into one directory.
///
/// The progress shows two mean returns: `train` is the mean of the last 100 training episodes, `eval` that of the latest
/// evaluation. Then come ε (the probability of a random action) and the loss of the last episode. --live shows more. Press q
/// to leave that view: while the run is training, q also stops the run with a checkpoint.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: cartpole-dqn train --config tutorial --seed 7 --set gamma=0.99")]
pub(super) struct TrainArguments {
    #[command(flatten)]
    layers: super::layers::Layers,
    /// Directory to write the run to [default: runs/<config name>-s<seed>-<UTC time>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace the run that is already in the directory
    #[arg(long)]
    force: bool,
    /// Resume the run in this directory from its last checkpoint; --set can give it a larger budget
    #[arg(long, value_name = "DIR", conflicts_with_all = ["config", "out", "force"])]
    resume: Option<PathBuf>,
    #[command(flatten)]
    allow: AllowCommand,
    /// Start with the weights of a policy, a run directory (its best) or a .safetensors file; all else starts afresh
    #[arg(long, value_name = "CHECKPOINT", conflicts_with = "resume")]
    init_from: Option<PathBuf>,
    /// Also write event files for TensorBoard, into the run's subdirectory `tensorboard`
    #[arg(long)]
    tensorboard: bool,
    /// Show no progress and no summary
    #[arg(long)]
    quiet: bool,
    /// Instead of the progress, print a line for every N-th training episode
    #[arg(long, value_name = "N", conflicts_with_all = ["quiet", "live"], allow_negative_numbers = true,
        value_parser = super::ui::integer::<1, { u64::MAX }>)]
    log_every: Option<u64>,
    /// Show the run in the terminal while it trains: learning curve, diagnostics, the latest policy at play
    #[arg(long, conflicts_with = "quiet")]
    live: bool,
    /// With --live: train at most at this multiple of simulated time (CartPole: 50 steps a second), for example 5x
    /// [default: full speed]
    #[arg(long, value_name = "FACTOR", requires = "live", allow_negative_numbers = true)]
    pace: Option<Pace>,
    /// Print the summary as JSON, and nothing else, on standard output
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: TrainArguments) -> Result<(), Failure> {
    if arguments.live {
        check_terminal()?;
    }
    let started = match &arguments.resume {
        Some(path) => {
            let run = format!("run {}", shown(path));
            resume(path, &arguments.layers.sets(), |environment| {
                arguments.allow.permit(environment, &run, arguments.live)
            })?
        }
        None => Resumed::Run(Box::new(start_new(&arguments)?)),
    };
    // Before that a signal ends the process at once: it may wait for its input or a silent program, and nothing is trained.
    let signals = Signals::listen(arguments.live);
    let Started { dir: run, config, mut trainer, recorder, notes } = match started {
        Resumed::Run(started) => *started,
        Resumed::Ended(ended) => return has_ended(&ended, arguments.json),
    };
    notes.iter().for_each(|text| note(text));
    if !arguments.quiet && !arguments.json {
        say(&announce(&arguments, &run, &trainer));
    }
    if !arguments.live {
        signals.tell_if_slow();
    }
    let mut observers = observers(&arguments, &run, &config, recorder, &trainer, &signals)?;
    let start = std::time::Instant::now();
    let result = trainer.run(&mut observers, &signals.stop);
    let seconds = start.elapsed().as_secs_f64();
    let error = match result {
        Ok(EndReason::Interrupted) => None,
        Ok(reason) => {
            let record = RunRecord::new(&run, &trainer, reason, seconds, cpu_seconds());
            // The summary is also printed when it cannot be saved.
            let saved = run.write_json(&run.summary(), &record);
            drop(observers);
            match (arguments.json, arguments.quiet) {
                (true, _) => print_json(&record)?,
                (false, true) => {}
                (false, false) => print(&describe(&record, &trainer, &run, allowance(&config)))?,
            }
            return saved.map_err(|error| cannot_write(&run.summary(), &error, ""));
        }
        Err(error) => Some(error),
    };
    if let Some(error @ TrainError::Diverged { .. }) = &error {
        // Training it again would end the same way. Where this cannot be written, the run is one that was stopped.
        let _ = run.set_failed(Some(error.to_string()));
    }
    drop(observers);
    let exit_code = match error {
        None => Some(signals.exit_code()),
        Some(TrainError::Diverged { .. }) => None,
        Some(_) => signals::asked(),
    };
    if arguments.json {
        // No file says that a run was stopped or failed, so these are no reasons of a record.
        let mut record = json!(RunRecord::new(&run, &trainer, EndReason::Budget, seconds, cpu_seconds()));
        record["end_reason"] = json!(if exit_code.is_some() { "interrupted" } else { "failed" });
        if let Some(error) = &error {
            record["error"] = json!(error.to_string());
        }
        print_json(&record)?;
    }
    let stopped = if exit_code.is_some() { "stopped: " } else { "" };
    let message = match error {
        None => {
            let (steps, command) = (trainer.progress().env_steps, resume_command(&run, &config));
            format!("stopped after step {steps}; resume with:\n  {command}")
        }
        Some(error) => format!("{stopped}{error}; {}", what_is_kept(&run, &config, &error)),
    };
    Err(match exit_code {
        Some(exit_code) => Failure::Interrupted(message, exit_code),
        None => Failure::Failed(message),
    })
}

fn has_ended(ended: &EndedRun, json: bool) -> Result<(), Failure> {
    let how = format!("{}. To train on, type\n  {}", ended.why, extending_command(ended));
    if ended.is_extended {
        let path = shown(ended.dir.path());
        let problem = format!("directory {path}: with these settings nothing is trained: {how}");
        return Err(Failure::BadInput(problem));
    }
    note(&how);
    if json { print_json(&read_summary(&ended.dir)?) } else { Ok(()) }
}

fn what_is_kept(run: &RunDir, config: &Config, error: &TrainError) -> String {
    let path = run.path().display();
    let kept = match run.last().is_file() {
        true => "the last good checkpoint",
        false if run.metrics().is_file() => "what was written",
        false => {
            return format!("the directory {path} is gone or was emptied, and the run with it; train again");
        }
    };
    let resume = match error {
        TrainError::Diverged { .. } => String::new(),
        _ => format!("; when the problem is solved, resume with: {}", resume_command(run, config)),
    };
    format!("{kept} is kept in {path}{resume}")
}

fn observers<'a>(
    arguments: &TrainArguments, run: &RunDir, config: &Config, recorder: Recorder, trainer: &Trainer,
    signals: &Signals,
) -> Result<Fanout<'a>, Failure> {
    let (budget, env_steps) = (config.budget, trainer.progress().env_steps);
    let mut observers = Fanout::default();
    observers.0.push(Box::new(recorder));
    if arguments.live {
        let pace = arguments.pace.unwrap_or(Pace::FULL);
        let (name, end_process) = (run.path().to_string_lossy(), signals.end_process());
        let environment = (config.make())(trainer.spec().max_steps)?;
        let live = Live::open(&name, environment, budget, env_steps, pace, &signals.interrupts, end_process)?;
        observers.0.push(Box::new(live));
    } else if let Some(every) = arguments.log_every {
        observers.0.push(Box::new(EpisodeLog::new(budget, every)));
    } else if !arguments.quiet {
        observers.0.push(Box::new(Console::new(budget, env_steps)));
    }
    // A resumed run that has event files continues them.
    if arguments.tensorboard || (arguments.resume.is_some() && run.has_events()) {
        let (path, rate) = (run.tensorboard(), config.agent.learning_rate());
        let learning_rate = move |steps| rate.after(steps);
        let directory = run.directory();
        let events = directory.and_then(|run| TensorBoard::create(run, &path, env_steps, learning_rate));
        observers.0.push(Box::new(events.map_err(|error| cannot_write(&path, &error, ""))?));
    }
    Ok(observers)
}

fn start_new(arguments: &TrainArguments) -> Result<Started, Failure> {
    let TrainArguments { layers, force, init_from, .. } = arguments;
    let mut config = layers.resolve()?;
    ask_task(&mut config, arguments.live)?;
    config.check_memory(1).map_err(Failure::BadInput)?;
    let default_out = || {
        let time = humantime::format_rfc3339_millis(std::time::SystemTime::now()).to_string();
        let time = time.replace(['-', ':', '.'], "");
        Path::new("runs").join(format!("{}-s{}-{time}", layers.name(), config.seed))
    };
    let out = arguments.out.clone().unwrap_or_else(default_out);
    check_out(&out)?;
    Ok(start(&out, *force, &layers.name(), &config, init_from.as_deref())?)
}

/// The first line: what is trained, with which seed, and where it is written.
fn announce(arguments: &TrainArguments, run: &RunDir, trainer: &Trainer) -> String {
    let (seed, budget) = (trainer.config().seed, budget(trainer.config().budget));
    let what = match arguments.resume {
        Some(_) => format!("resuming at step {}", trainer.progress().env_steps),
        None => format!("training {}", arguments.layers.name()),
    };
    let from = arguments.init_from.as_deref();
    let from = from.map_or(String::new(), |path| format!(", from the weights of {}", shown(path)));
    let label = format!("{what}: seed {seed}, budget {budget}{from}, in");
    fitting(&label, &run.path().display().to_string())
}

fn budget(budget: Budget) -> String {
    match budget {
        Budget::Steps(steps) => format!("{steps} steps"),
        Budget::Episodes(episodes) => format!("{episodes} episodes"),
    }
}

/// Two texts in a line, or in two where one would not fit into a terminal of 80 columns.
fn fitting(label: &str, value: &str) -> String {
    let fits = label.chars().count() + value.chars().count() < 80;
    if fits { format!("{label} {value}") } else { format!("{}\n  {value}", label.trim_end()) }
}

fn describe(record: &RunRecord, trainer: &Trainer, run: &RunDir, allowance: &str) -> String {
    let Summary { env_steps, episodes, updates, evaluation_steps, lasting_test_steps, .. } = record.summary;
    let Summary { seed, wall_seconds, .. } = record.summary;
    let cpu = record.cpu_seconds.map_or_else(String::new, |seconds| format!("; {seconds:.2} s of CPU"));
    let evaluations = [record.summary.best_evaluation, record.summary.final_evaluation];
    let task = trainer.spec();
    let ended = match record.summary.end_reason {
        EndReason::Solved => "the first evaluation that solved the task (stop_when_solved)".into(),
        EndReason::Lasting => {
            let steps = trainer.config().stop_when_lasting_steps.unwrap_or_default();
            format!("the policy lasts {steps} steps (stop_when_lasting_steps)")
        }
        _ => format!("the whole budget of {} was trained", budget(trainer.config().budget)),
    };
    let training = record.mean_return_100.map_or_else(
        || "no episode has ended".into(),
        |mean| format!("mean return {mean:.1} over the last {} training episodes", episodes.min(100)),
    );
    let [best, final_] = evaluations.map(|e| e.map_or_else(|| "none".into(), |e| evaluated(e, task)));
    let collapsed = match evaluations.map(|e| e.map(|e| task.is_solved_by(e.mean))) {
        [Some(true), Some(false)] => {
            "\nIn its evaluation the final policy no longer solves the task. The best policy is kept; use that one.\n"
        }
        _ => "",
    };
    let learned = if trainer.agent().as_dqn().is_some() { "online network" } else { "table" };
    let path = run.path().display().to_string();
    let (program, argument) = (program(), shell_word(&path));
    format!(
        "\
{}
trained    {env_steps} steps, {episodes} episodes, {updates} updates in {wall_seconds:.2} s (seed {seed})
played     {evaluation_steps} steps in evaluations, {lasting_test_steps} to test the end{cpu}
ended      {ended}
training   {training}
best       {best}
final      {final_}
weights    SHA-256 of the {learned} at the end:
           {}
{collapsed}
Next: play the best policy on new episodes, watch it, draw the learning curve.
  {program} eval {argument}{allowance}
  {program} watch {argument}{allowance}
  {program} report {argument}
",
        fitting("run       ", &path),
        record.summary.weights_sha256,
    )
}

fn evaluated(Evaluation { mean, env_steps }: Evaluation, task: &crate::env::Spec) -> String {
    let verdict = |threshold| if mean >= threshold { ": solved" } else { ": not solved" };
    let solved = task.solved_return.map_or("", verdict);
    format!("mean return {mean:.1} in the evaluation at step {env_steps}{solved}")
}

/// What trains a run on that has ended, or a new run like it that does not end where it did.
fn extending_command(EndedRun { dir, config, sets, can_resume, .. }: &EndedRun) -> String {
    let sets: String = sets.iter().map(|set| format!(" --set {}", shell_word(set))).collect();
    if *can_resume {
        return resume_command(dir, config) + &sets;
    }
    let config_file = dir.config();
    let config_file = shell_word(&config_file.to_string_lossy());
    format!("{} train --config {config_file}{}{sets}", program(), allowance(config))
}

fn resume_command(run: &RunDir, config: &Config) -> String {
    format!("{} train --resume {}{}", program(), shell_word(&run.path().to_string_lossy()), allowance(config))
}

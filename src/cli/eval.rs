//! `cartpole-dqn eval`

use std::io::{self, Write};
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::output::Output;
use super::policy::{Found, Place};
use super::run_dir::final_evaluation;
use super::{Failure, print, print_json};
use crate::agent::{Policy, Random};
use crate::checkpoint::weights_sha256;
use crate::env::{CartPole, Environment, TimeLimit};
use crate::rng::Rng;
use crate::text::{shown, visible};
use crate::trainer::{Evaluation, SavedPolicy, Score, evaluate, play};

type Task = TimeLimit<CartPole>;

/// How every trace begins.
const TRACE_START: &[u8] = b"{\"episode\":0,\"seed\":";

/// Play a trained policy and score it.
///
/// Plays 100 episodes with the greedy policy and prints statistics of their returns. Episode i starts as Gymnasium's
/// CartPole-v1 does after reset(seed = SEED + i), so every score can be repeated there.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn eval runs/my-run --episodes 100 --min-mean 475")]
pub(super) struct Arguments {
    #[command(flatten)]
    place: Place,
    /// Play a policy that needs no checkpoint
    #[arg(long, conflicts_with_all = ["path", "checkpoint"])]
    policy: Option<Baseline>,
    /// Number of episodes
    #[arg(long, value_name = "N", default_value_t = 100, allow_negative_numbers = true,
        value_parser = super::integer::<1, 10_000_000>)]
    episodes: u64,
    /// Gymnasium seed of the first episode; each later episode has the next seed
    #[arg(long, value_name = "S", default_value_t = 2_000_000, value_parser = super::seed,
        allow_negative_numbers = true)]
    seed: u64,
    /// Cut episodes off after N steps; CartPole-v1 does so after 500, and "solved" is judged there
    #[arg(long, value_name = "N", default_value_t = u64::from(CartPole::MAX_STEPS), allow_negative_numbers = true,
        value_parser = super::integer::<1, 1_000_000_000>)]
    max_steps: u64,
    /// Exit with code 1 if the mean return is below this
    #[arg(long, value_name = "X", value_parser = finite, allow_negative_numbers = true)]
    min_mean: Option<f64>,
    /// Write every step to this file, one JSON object per line; "-" is standard output, and the score then goes to stderr
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Print the score as JSON, and nothing else, on standard output
    #[arg(long)]
    json: bool,
    /// Print no score and no notes; the exit code still says whether --min-mean was reached
    #[arg(long, conflicts_with = "json")]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Baseline {
    /// Every action with the same probability
    Random,
}

#[derive(Serialize)]
struct Report<'a> {
    policy: &'a Played,
    episodes: u64,
    seed: u64,
    max_steps: u64,
    mean: f64,
    std: f64,
    min: f64,
    median: f64,
    max: f64,
    solved: bool,
    returns: &'a [f64],
}

/// Which policy was played.
#[derive(Default, Serialize)]
struct Played {
    /// `best` or `last` of a run, `other` (of another program) or `random`.
    kind: &'static str,
    file: Option<String>,
    /// Environment steps of training before it.
    env_steps: Option<u64>,
    /// The latest evaluation in training until then.
    evaluation: Option<Evaluation>,
    weights_sha256: Option<String>,
    /// The evaluation at the end of the run, if the policy is not that of the end, and the file of that one.
    #[serde(skip)]
    end: Option<(Evaluation, PathBuf)>,
}

/// One line of `--trace`.
#[derive(Serialize)]
struct TraceLine<'a> {
    episode: u64,
    seed: u64,
    step: u64,
    state: &'a [f64],
    action: usize,
    q_values: Vec<f32>,
    reward: f32,
    terminated: bool,
    truncated: bool,
}

fn finite(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| "expected a finite number".into())
}

pub(super) fn run(arguments: Arguments) -> Result<(), Failure> {
    if arguments.seed.checked_add(arguments.episodes - 1).is_none() {
        return Err(Failure::BadInput(format!(
            "--seed {} + --episodes {} is beyond the largest seed, {}",
            arguments.seed,
            arguments.episodes,
            u64::MAX
        )));
    }
    let trace = arguments.trace.as_deref().map(|path| Output {
        option: "--trace",
        path,
        what: "a trace",
        is_own: |start| start.starts_with(TRACE_START),
    });
    let trace_to_stdout = trace.as_ref().is_some_and(Output::is_standard);
    if trace_to_stdout && arguments.json {
        return Err(Failure::BadInput(
            "--trace - and --json both want standard output; give the trace a file, or leave --json out"
                .into(),
        ));
    }
    trace.as_ref().map_or(Ok(()), Output::check)?;
    let (played, returns) = match arguments.policy {
        Some(Baseline::Random) => {
            let mut policy = Random::new(Task::NUM_ACTIONS, Rng::from_seed(arguments.seed));
            let played = Played { kind: "random", ..Played::default() };
            (played, play_all(&mut policy, &arguments, trace.as_ref())?)
        }
        None => {
            let found = arguments.place.find(arguments.json || arguments.quiet)?;
            let policy = found.policy()?;
            let returns = match &trace {
                None => {
                    Some(evaluate(&policy.network, &arguments.task(), arguments.seed, arguments.episodes))
                }
                Some(_) => play_all(&mut policy.greedy(1), &arguments, trace.as_ref())?,
            };
            (Played::new(&found, &policy), returns)
        }
    };
    // Who read the trace wants no more of it, and no score either.
    let Some(returns) = returns else { return Ok(()) };
    let score = Score::new(&returns);
    if arguments.json {
        print_json(&report(&played, &score, &returns, &arguments))?;
    } else if !arguments.quiet {
        let text = played.describe() + &describe(&score, &returns, &arguments);
        if trace_to_stdout {
            // A closed stderr leaves nobody to tell.
            let _ = io::stderr().write_all(text.as_bytes());
        } else {
            print(&text)?;
        }
    }
    match arguments.min_mean {
        Some(minimum) if score.mean < minimum => {
            Err(Failure::Failed(format!("mean return {:.2} is below --min-mean {minimum}", score.mean)))
        }
        _ => Ok(()),
    }
}

impl Played {
    fn new(found: &Found, policy: &SavedPolicy) -> Self {
        let played = Self {
            kind: "other",
            file: Some(found.file.to_string_lossy().into_owned()),
            weights_sha256: Some(weights_sha256(&policy.network)),
            ..Self::default()
        };
        let Some(header) = &policy.header else { return played };
        let end = final_evaluation(&found.place).filter(|(end, _)| end.env_steps != header.env_steps);
        Self {
            kind: if header.state.is_some() { "last" } else { "best" },
            env_steps: Some(header.env_steps),
            evaluation: header.evaluation,
            end,
            ..played
        }
    }

    /// The lines above the score.
    fn describe(&self) -> String {
        let mut text = match self.env_steps {
            Some(step) => {
                let evaluation = self.evaluation.map_or_else(String::new, |evaluation| {
                    // The last policy of a run can be some steps younger than its latest evaluation.
                    let at = match evaluation.env_steps {
                        evaluated if evaluated == step => String::new(),
                        evaluated => format!(" at step {evaluated}"),
                    };
                    format!(", evaluated in training{at}: {:.2}", evaluation.mean)
                });
                format!("policy         {} of its run, step {step}{evaluation}\n", self.kind)
            }
            None if self.file.is_some() => "policy         written by another program\n".into(),
            None => format!("policy         {}\n", self.kind),
        };
        if let Some(file) = &self.file {
            text += &format!("file           {}\n", visible(file));
        }
        if let Some((end, file)) = &self.end {
            let (mean, step) = (end.mean, end.env_steps);
            text +=
                &format!("not played     last of its run, step {step}, evaluated in training: {mean:.2}\n");
            text += &format!("               {}\n", shown(file));
        }
        text
    }
}

/// Plays one episode after another, and writes the trace if one is asked for; none if nobody reads it any longer.
fn play_all(
    policy: &mut impl Policy,
    arguments: &Arguments,
    trace: Option<&Output<'_>>,
) -> Result<Option<Vec<f64>>, Failure> {
    let mut returns = Vec::new();
    let mut play = |file: &mut dyn Write| -> io::Result<()> {
        for episode in 0..arguments.episodes {
            returns.push(trace_episode(policy, arguments, episode, file)?);
        }
        Ok(())
    };
    let is_read = match trace {
        None => play(&mut io::sink()).map(|()| true).map_err(|error| Failure::Failed(error.to_string()))?,
        Some(trace) => trace.write(play)?,
    };
    Ok(is_read.then_some(returns))
}

fn trace_episode(
    policy: &mut impl Policy,
    arguments: &Arguments,
    episode: u64,
    file: &mut dyn Write,
) -> io::Result<f64> {
    let seed = arguments.seed + episode;
    play(policy, arguments.task(), seed, |traced| {
        let line = TraceLine {
            episode,
            seed,
            step: traced.step,
            state: traced.state,
            action: traced.action,
            q_values: traced.q_values,
            reward: traced.outcome.reward,
            terminated: traced.outcome.terminated,
            truncated: traced.outcome.truncated,
        };
        serde_json::to_writer(&mut *file, &line)?;
        file.write_all(b"\n")
    })
}

impl Arguments {
    fn task(&self) -> Task {
        // The largest limit that the option takes is far below.
        CartPole::limited(u32::try_from(self.max_steps).unwrap_or(u32::MAX))
    }
}

/// Whether the returns solve CartPole-v1, which cuts episodes off after 500 steps: every step is worth 1.
fn solves(returns: &[f64]) -> bool {
    let cut_off: Vec<f64> = returns.iter().map(|value| value.min(Task::MAX_RETURN)).collect();
    Score::new(&cut_off).solves(Task::SOLVED_RETURN)
}

fn report<'a>(policy: &'a Played, score: &Score, returns: &'a [f64], arguments: &Arguments) -> Report<'a> {
    let Arguments { seed, max_steps, .. } = *arguments;
    let Score { episodes, mean, std, min, median, max } = *score;
    Report {
        policy,
        episodes,
        seed,
        max_steps,
        mean,
        std,
        min,
        median,
        max,
        solved: solves(returns),
        returns,
    }
}

fn describe(score: &Score, returns: &[f64], arguments: &Arguments) -> String {
    let Score { episodes, mean, std, min, median, max } = score;
    let interval = score.interval().map_or(String::new(), |half| format!(" ± {half:.2} (95 % interval)"));
    let limit = arguments.max_steps as f64;
    let full = returns.iter().filter(|&&value| value >= limit).count() as f64 * 100.0 / *episodes as f64;
    let solved = match (solves(returns), *episodes >= 100 && limit >= Task::MAX_RETURN) {
        (true, _) => "yes",
        (false, true) => "no",
        (false, false) => "open",
    };
    let judged = match limit == Task::MAX_RETURN {
        true => "",
        false => "\n               episodes count up to step 500, where CartPole-v1 ends",
    };
    format!(
        "\
mean return    {mean:.2}{interval}
std            {std:.2}
min/median/max {min} / {median} / {max}
at {:<11} {full:.0} % of episodes
episodes       {episodes}, Gymnasium's seeds {} to {}
solved         {solved} (a mean ≥ {} over at least 100 episodes){judged}
",
        limit,
        arguments.seed,
        arguments.seed + (episodes - 1),
        Task::SOLVED_RETURN,
    )
}

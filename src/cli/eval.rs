//! `cartpole-dqn eval`

use std::io::{self, Write};
use std::path::PathBuf;

use serde::Serialize;
use serde_json::json;

use super::output::{Output, WriteError};
use super::policy::{DEFAULT_ENVIRONMENT, LocatedPolicy, PolicyArguments};
use super::ui::{Failure, print, print_json};
use crate::agent::{Actor, Played, Random};
use crate::config::EnvironmentConfig;
use crate::env::{Make, Outcome, Spec};
use crate::trainer::{Evaluation, SCORE_SEED, Score, evaluate, play};

const TRACE_START: &[u8] = b"{\"episode\":0,\"seed\":";

/// Play a trained policy and score it.
///
/// Plays 100 episodes with the greedy policy and prints statistics of their returns. Episode i starts as Gymnasium's
/// environment does after reset(seed = SEED + i), so every score can be repeated there.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: cartpole-dqn eval runs/my-run --episodes 100 --min-mean 475")]
pub(super) struct EvalArguments {
    #[command(flatten)]
    place: PolicyArguments,
    #[command(flatten)]
    allow: super::permission::AllowCommand,
    /// Play a policy that needs no checkpoint
    #[arg(long, conflicts_with_all = ["path", "checkpoint"])]
    policy: Option<Baseline>,
    /// Number of episodes
    #[arg(long, value_name = "N", default_value_t = 100, allow_negative_numbers = true,
        value_parser = super::ui::integer::<1, 10_000_000>)]
    episodes: u64,
    /// Gymnasium seed of the first episode; each later episode has the next seed
    #[arg(long, value_name = "S", default_value_t = SCORE_SEED, value_parser = super::ui::seed,
        allow_negative_numbers = true)]
    seed: u64,
    /// Cut episodes off after N steps in place of the environment's own limit, at which "solved" is judged [default: that
    /// limit, 500 for CartPole-v1]
    #[arg(long, value_name = "N", allow_negative_numbers = true,
        value_parser = super::ui::integer::<1, 1_000_000_000>)]
    max_steps: Option<u64>,
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

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Baseline {
    /// Every action with the same probability
    Random,
}

#[derive(Default, Serialize)]
struct Origin {
    /// `best` or `last` of a run, `other` (of another program) or `random`.
    kind: &'static str,
    file: Option<String>,
    /// Environment steps of training before it.
    env_steps: Option<u64>,
    /// The latest evaluation in training until then.
    evaluation: Option<Evaluation>,
    weights_sha256: Option<String>,
    /// If the policy is not the last of its run: the evaluation at the end of the run, and the file of the last policy.
    #[serde(skip)]
    end: Option<(Evaluation, PathBuf)>,
}

#[derive(Default, Serialize)]
struct TraceLine {
    episode: u64,
    seed: u64,
    step: u64,
    state: Vec<f64>,
    action: usize,
    q_values: Vec<f32>,
    reward: f64,
    terminated: bool,
    truncated: bool,
}

fn finite(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| "expected a finite number".into())
}

pub(super) fn run(arguments: EvalArguments) -> Result<(), Failure> {
    let EvalArguments { seed, episodes, .. } = arguments;
    if seed.checked_add(episodes - 1).is_none() {
        let most = u64::MAX;
        let problem = format!("--seed {seed} + --episodes {episodes} is beyond the largest seed, {most}");
        return Err(Failure::BadInput(problem));
    }
    let is_own = |start: &[u8]| start.starts_with(TRACE_START);
    let output = |path| Output { option: "--trace", path, what: "a trace", is_own };
    let trace = arguments.trace.as_deref().map(output);
    let trace_to_stdout = trace.as_ref().is_some_and(Output::is_standard);
    if trace_to_stdout && arguments.json {
        return Err(Failure::BadInput(
            "--trace - and --json both want standard output; give the trace a file, or leave --json out"
                .into(),
        ));
    }
    trace.as_ref().map_or(Ok(()), Output::check)?;
    let (origin, task, played) = match arguments.policy {
        Some(Baseline::Random) => {
            let environment = arguments.place.environment.unwrap_or(DEFAULT_ENVIRONMENT);
            let task = Task::new(&EnvironmentConfig::Named(environment), &arguments)?;
            let (num_actions, rng) = (task.spec.num_actions, crate::rng::Rng::from_seed(seed));
            let origin = Origin { kind: "random", ..Origin::default() };
            let played = task.play_all(&mut Random { num_actions, rng }, trace.as_ref())?;
            (origin, task, played)
        }
        None => {
            let found = arguments.place.find(arguments.json || arguments.quiet)?;
            let policy = found.policy()?;
            let task = Task::new(&found.playable(arguments.allow, false)?, &arguments)?;
            let played = match &trace {
                None => Some(evaluate(&policy.policy, &*task.make, task.max_steps, seed, episodes, 1.0)?),
                Some(_) => task.play_all(&mut policy.greedy(1), trace.as_ref())?,
            };
            (Origin::new(&found, &policy), task, played)
        }
    };
    // Whoever read the trace wants no more of it, and no score either.
    let Some(played) = played else { return Ok(()) };
    // Without a discount that is the return of the whole episode.
    let returns: Vec<f64> = played.iter().map(|episode| episode.discounted).collect();
    let score = Score::new(&returns);
    let solved = task.is_solved_by(&played);
    if arguments.json {
        let Score { episodes, mean, std, min, median, max } = score;
        print_json(&json!({
            "policy": origin, "episodes": episodes, "seed": arguments.seed, "max_steps": task.max_steps,
            "mean": mean, "std": std, "min": min, "median": median, "max": max,
            "solved": solved, "returns": returns,
        }))?;
    } else if !arguments.quiet {
        let text = origin.describe() + &task.describe(&score, &played, solved);
        if trace_to_stdout {
            // A closed stderr leaves nobody to tell.
            let _ = io::stderr().write_all(text.as_bytes());
        } else {
            print(&text)?;
        }
    }
    let mean = score.mean;
    match arguments.min_mean.filter(|minimum| mean < *minimum) {
        Some(low) => Err(Failure::Failed(format!("mean return {mean:.2} is below --min-mean {low}"))),
        None => Ok(()),
    }
}

impl Origin {
    fn new(found: &LocatedPolicy, policy: &crate::run::SavedPolicy) -> Self {
        let file = Some(found.file.to_string_lossy().into_owned());
        let weights_sha256 = Some(policy.policy.sha256());
        let played = Self { kind: "other", file, weights_sha256, ..Self::default() };
        let Some(header) = &policy.header else { return played };
        let (kind, env_steps) = (if header.progress.is_some() { "last" } else { "best" }, header.env_steps);
        // A checkpoint does not know of an evaluation that only the end of the run brought.
        let end = crate::run::final_evaluation(&found.file);
        let at_end =
            end.as_ref().map(|(end, _)| *end).filter(|end| kind == "last" && end.env_steps == env_steps);
        let end = end.filter(|(end, _)| end.env_steps != env_steps);
        Self { kind, env_steps: Some(env_steps), evaluation: at_end.or(header.evaluation), end, ..played }
    }

    fn describe(&self) -> String {
        let mut text = match self.env_steps {
            Some(step) => {
                // The last policy of a run can be some steps younger than its latest evaluation.
                let at = |steps| if steps == step { String::new() } else { format!(" at step {steps}") };
                let evaluation = self.evaluation.map_or_else(String::new, |evaluation| {
                    format!(", evaluated in training{}: {:.2}", at(evaluation.env_steps), evaluation.mean)
                });
                format!("policy         {} of its run, step {step}{evaluation}\n", self.kind)
            }
            None if self.file.is_some() => "policy         written by another program\n".into(),
            None => format!("policy         {}\n", self.kind),
        };
        if let Some(file) = &self.file {
            text += &format!("file           {}\n", crate::text::visible(file));
        }
        if let Some((end, file)) = &self.end {
            let (mean, step) = (end.mean, end.env_steps);
            text += &format!(
                "not played     last of its run, step {step}, evaluated in training: {mean:.2}\n               {}\n",
                crate::text::shown(file)
            );
        }
        text
    }
}

/// What is played: an environment under the time limit of --max-steps.
struct Task<'a> {
    arguments: &'a EvalArguments,
    make: std::sync::Arc<Make>,
    spec: Spec,
    max_steps: u32,
}

impl<'a> Task<'a> {
    fn new(environment: &EnvironmentConfig, arguments: &'a EvalArguments) -> Result<Self, Failure> {
        let spec = environment.spec()?;
        // The largest limit that the option takes is far below.
        let typed = arguments.max_steps.map(|steps| u32::try_from(steps).unwrap_or(u32::MAX));
        let max_steps = typed.unwrap_or(spec.max_steps);
        Ok(Self { arguments, make: environment.make(), spec, max_steps })
    }

    /// Whether the episodes solve the task; none for fewer than 100, for a limit below the task's own, and without a threshold.
    fn is_solved_by(&self, played: &[Played]) -> Option<bool> {
        let can_tell = played.len() >= 100 && self.max_steps >= self.spec.max_steps;
        let scored: Vec<f64> = played.iter().map(|episode| episode.total).collect();
        let threshold = self.spec.solved_return.filter(|_| can_tell)?;
        Some(Score::new(&scored).mean >= threshold)
    }

    /// Plays one episode after another, and writes the trace if one is asked for; none if nobody reads it any longer.
    fn play_all(
        &self, actor: &mut impl Actor, trace: Option<&Output<'_>>,
    ) -> Result<Option<Vec<Played>>, Failure> {
        let mut played = Vec::new();
        let mut play = |file: &mut dyn Write| -> Result<(), WriteError> {
            for episode in 0..self.arguments.episodes {
                played.push(self.play_episode(actor, episode, file)?);
            }
            Ok(())
        };
        let is_read = match trace {
            None => play(&mut io::sink()).map(|()| true)?,
            Some(trace) => trace.write(play)?,
        };
        Ok(is_read.then_some(played))
    }

    fn play_episode(
        &self, actor: &mut impl Actor, episode: u64, file: &mut dyn Write,
    ) -> Result<Played, WriteError> {
        let seed = self.arguments.seed + episode;
        let mut environment = (self.make)(self.max_steps)?;
        let (mut played, mut line) = (Played::default(), None);
        play(actor, &mut *environment, seed, |moment| {
            if let (Some(line), Some(outcome)) = (line.take(), moment.outcome) {
                let Outcome { reward, terminated, truncated } = outcome;
                played.count(outcome, self.spec.max_steps.into(), 1.0);
                let line = TraceLine { reward, terminated, truncated, ..line };
                serde_json::to_writer(&mut *file, &line).map_err(io::Error::from)?;
                file.write_all(b"\n")?;
            }
            let (step, state, q_values) = (moment.step, moment.state(), moment.q_values);
            let begun = TraceLine { episode, seed, step, state, q_values, ..TraceLine::default() };
            line = moment.action.map(|action| TraceLine { action, ..begun });
            Ok::<_, WriteError>(true)
        })?;
        Ok(played)
    }

    fn describe(&self, score: &Score, played: &[Played], solved: Option<bool>) -> String {
        let Score { episodes, mean, std, .. } = score;
        let [min, median, max] = [score.min, score.median, score.max].map(|x| (x * 100.0).round() / 100.0);
        let interval = score.interval().map_or(String::new(), |half| format!(" ± {half:.2} (95 % interval)"));
        let (seed, max_steps, task) = (self.arguments.seed, self.max_steps, &self.spec);
        let full = played.iter().filter(|episode| episode.steps >= u64::from(max_steps)).count();
        let full = full as f64 * 100.0 / *episodes as f64;
        let verdict = solved.map_or("open", |solved| if solved { "yes" } else { "no" });
        let solved = match task.solved_return {
            Some(_) => format!("{verdict} (a mean {} over at least 100 episodes)", task.goal()),
            None => format!("{verdict} ({} has no threshold)", task.id),
        };
        let judged = match task.max_steps {
            own if own == max_steps => String::new(),
            own => format!("\n               episodes count up to step {own}, where {} ends", task.id),
        };
        format!(
            "\
mean return    {mean:.2}{interval}
std            {std:.2}
min/median/max {min} / {median} / {max}
at {max_steps:<11} {full:.0} % of episodes
episodes       {episodes}, Gymnasium's seeds {seed} to {}
solved         {solved}{judged}
",
            seed + (episodes - 1),
        )
    }
}

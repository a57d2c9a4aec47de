//! What every command needs: how a command fails, and how it prints.

use std::io::{self, Write};
use std::path::Path;

use crate::config::{ConfigError, nearest_shipped};
use crate::env::EnvironmentError;
use crate::run::{CheckpointError, CheckpointProblem, RunError};
use crate::text::{limited, shell_word, shown, steers};
use crate::trainer::{ResumeError, TrainError};
use crate::view::NoView;

/// What stands before the command that would be started. A message with it is printed whole, however long the command is.
pub(super) const QUESTION: &str = "add --allow-command: ";

#[derive(Debug)]
pub(super) enum Failure {
    /// Something the user gave cannot be used: exit code 2.
    BadInput(String),
    /// It was tried and failed: exit code 1.
    Failed(String),
    /// Something around it failed, an environment or a disk: exit code 1, or that of a signal to the whole group of processes.
    Disturbed(String),
    /// A signal stopped it: that signal's exit code.
    Interrupted(String, u8),
}

impl Failure {
    /// A file that cannot be written: bad input in every command if the place can never be written, else a failure.
    pub(super) fn unwritten(message: String, error: &io::Error) -> Self {
        use io::ErrorKind as Kind;
        match error.kind() {
            Kind::PermissionDenied
            | Kind::ReadOnlyFilesystem
            | Kind::NotFound
            | Kind::NotADirectory
            | Kind::IsADirectory
            | Kind::AlreadyExists
            | Kind::InvalidFilename
            | Kind::InvalidInput => Self::BadInput(message),
            _ => Self::Failed(message),
        }
    }
}

impl From<ConfigError> for Failure {
    fn from(error: ConfigError) -> Self {
        let takes = "--config takes a JSON file, or a name that `cartpole-dqn config list` prints";
        match error {
            ConfigError::Environment(error) => error.into(),
            ConfigError::Read { ref path, ref source } if source.kind() == io::ErrorKind::NotFound => {
                let nearest = path.file_stem().and_then(|stem| nearest_shipped(&stem.to_string_lossy()));
                let meant = nearest.map_or_else(String::new, |name| format!("did you mean `{name}`? "));
                Self::BadInput(format!("{}; {meant}{takes}", on_one_line(&error)))
            }
            ConfigError::Read { .. } | ConfigError::Json { .. } => {
                Self::BadInput(format!("{}; {takes}", on_one_line(&error)))
            }
            _ => Self::BadInput(on_one_line(&error)),
        }
    }
}

impl From<CheckpointError> for Failure {
    fn from(error: CheckpointError) -> Self {
        let message = on_one_line(&error);
        match error.problem {
            CheckpointProblem::Resume(ResumeError::Environment(_)) => Self::Disturbed(message),
            CheckpointProblem::Unreadable(_) | CheckpointProblem::NotSafetensors(_) => {
                Self::BadInput(message + "; give a .safetensors file or the directory of a run")
            }
            _ => Self::BadInput(message),
        }
    }
}

impl From<EnvironmentError> for Failure {
    fn from(error: EnvironmentError) -> Self {
        Self::Disturbed(error.to_string())
    }
}

impl From<RunError> for Failure {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Checkpoint(error) => error.into(),
            RunError::Environment(error) => error.into(),
            RunError::Unwritable { ref source, .. } => Self::unwritten(error.to_string(), source),
            RunError::Failed(message) => Self::Failed(message),
            _ => Self::BadInput(on_one_line(&error)),
        }
    }
}

impl From<TrainError> for Failure {
    fn from(error: TrainError) -> Self {
        match error {
            TrainError::Diverged { .. } => Self::Failed(error.to_string()),
            _ => Self::Disturbed(error.to_string()),
        }
    }
}

impl From<NoView> for Failure {
    fn from(error: NoView) -> Self {
        match error {
            NoView::Environment(_) => Self::Disturbed(error.to_string()),
            NoView::Terminal(_) => Self::Failed(error.to_string()),
            _ => Self::BadInput(error.to_string()),
        }
    }
}

/// A text with its control characters, line breaks and tabs apart, written as in JSON: no name may change the terminal.
pub(super) fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        if steers(character) && !matches!(character, '\n' | '\t') {
            let mut units = [0; 2];
            escaped.extend(character.encode_utf16(&mut units).iter().map(|unit| format!("\\u{unit:04x}")));
        } else {
            escaped.push(character);
        }
    }
    escaped
}

pub(super) fn program() -> String {
    let program = std::env::args_os().next().unwrap_or_else(|| "cartpole-dqn".into());
    shell_word(&program.to_string_lossy())
}

pub(super) fn integer<const LOW: u64, const HIGH: u64>(text: &str) -> Result<u64, String> {
    let number = text.parse().ok().filter(|number| (LOW..=HIGH).contains(number));
    number.ok_or_else(|| format!("expected an integer from {LOW} to {HIGH}, in digits alone"))
}

pub(super) fn seed(text: &str) -> Result<u64, String> {
    integer::<0, { u64::MAX }>(text)
}

/// A message about one file, in whose name a line break must not begin a line.
pub(super) fn on_one_line(error: &impl std::fmt::Display) -> String {
    error.to_string().replace('\n', "\\n")
}

pub(super) fn note(text: &str) {
    say(&format!("note: {text}"));
}

/// Prints a line to stderr; a closed stderr leaves nobody to tell.
pub(super) fn say(text: &str) {
    let text = if text.contains(QUESTION) { text.into() } else { limited(text) };
    let _ = writeln!(io::stderr(), "{}", escaped(&text));
}

/// Prints to stdout. A reader that has gone away (`| head`) is no failure. JSON stays JSON: see [`escaped`].
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(escaped(text).as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(Failure::Failed(format!("cannot write to standard output: {error}")))
        }
        _ => Ok(()),
    }
}

pub(super) fn print_json(value: &impl serde::Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string(value).map_err(|error| Failure::Failed(error.to_string()))?;
    print(&(text + "\n"))
}

pub(super) fn cannot_write(path: &Path, error: &io::Error, hint: &str) -> Failure {
    Failure::unwritten(format!("cannot write {}: {error}{hint}", shown(path)), error)
}

/// Refuses `-` as an `--out`: everywhere else it is standard input or output, so that no command would find the directory.
pub(super) fn check_out(path: &Path) -> Result<(), Failure> {
    let problem = "--out -: a directory is needed, not standard output; give a name, such as runs/mine";
    if path.as_os_str() == "-" { Err(Failure::BadInput(problem.into())) } else { Ok(()) }
}

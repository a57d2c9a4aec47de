//! Whether a program that is an environment may be started: nobody's file starts one.

use std::io::{self, IsTerminal, Write};

use super::ui::{Failure, QUESTION, escaped, note};
use crate::config::{Config, EnvironmentConfig};

/// The user's word for a command that stands in a file.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct AllowCommand {
    /// Start the program that the run, checkpoint or study names as its environment, if it does; the command is printed first
    #[arg(long)]
    allow_command: bool,
}

impl AllowCommand {
    /// Allows the environment of `file`, a run or a checkpoint, to start its program, if it has one: see [`allow`].
    pub(super) fn permit(
        self, environment: &mut EnvironmentConfig, file: &str, has_view: bool,
    ) -> Result<(), String> {
        let Some(command) = environment.command() else { return Ok(()) };
        if !self.allow_command {
            return Err(format!(
                "{file} names a program as its environment, and a file alone starts no program. If you trust this command, \
                 {QUESTION}{command}"
            ));
        }
        note(&format!(
            "{file} names this program as its environment, and --allow-command starts it: {command}"
        ));
        allow(environment, has_view);
        Ok(())
    }
}

/// The extra option that commands on this run need.
pub(super) fn allowance(config: &Config) -> &'static str {
    if config.environment.command().is_some() { " --allow-command" } else { "" }
}

/// Allows an environment that the user has given to start its program. A full-screen view hides what the program writes.
pub(super) fn allow(environment: &mut EnvironmentConfig, has_view: bool) {
    environment.allow(if has_view { |_, _| false } else { show_line });
}

pub(super) fn ask_task(config: &mut Config, has_view: bool) -> Result<(), Failure> {
    allow(&mut config.environment, has_view);
    Ok(config.ask_task()?)
}

/// The programs of a study: configs with the same one share its processes.
#[derive(Default)]
pub(super) struct SharedPrograms(Vec<(EnvironmentConfig, EnvironmentConfig)>);

impl SharedPrograms {
    /// Has `allow` change the first of equal environments, and gives the others what that one became.
    pub(super) fn share<E>(
        &mut self, environment: &mut EnvironmentConfig,
        allow: impl FnOnce(&mut EnvironmentConfig) -> Result<(), E>,
    ) -> Result<(), E> {
        if let Some((_, allowed)) = self.0.iter().find(|(given, _)| given == environment) {
            *environment = allowed.clone();
            return Ok(());
        }
        let given = environment.clone();
        allow(environment)?;
        self.0.push((given, environment.clone()));
        Ok(())
    }
}

fn show_line(program: &str, line: &str) -> bool {
    let mut stderr = io::stderr().lock();
    // The line takes the place of a progress bar, which is drawn again below it.
    let erase = if stderr.is_terminal() { "\r\x1b[2K" } else { "" };
    // A closed stderr leaves nobody to tell.
    writeln!(stderr, "{erase}[{}] {}", escaped(program), escaped(line)).is_ok()
}

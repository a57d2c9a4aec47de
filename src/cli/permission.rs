//! Whether a program that is an environment may be started: nobody's file starts one.

use std::io::{self, IsTerminal, Write};

use clap::Args;

use super::ui::{Failure, QUESTION, escaped, note};
use crate::config::{Config, EnvironmentConfig};

/// The user's word for a command that stands in a file.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct AllowCommand {
    /// Start the program that the run, checkpoint or study names as its environment, if it does; the command is printed first
    #[arg(long)]
    allow_command: bool,
}

impl AllowCommand {
    /// Allows the environment of a run or a checkpoint, `file`, to start its program, if it has one. See [`ask_task`] for
    /// `has_view`.
    ///
    /// # Errors
    /// The message, when the user has not said so.
    pub(super) fn permit(
        self,
        environment: &mut EnvironmentConfig,
        file: &str,
        has_view: bool,
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
        environment.allow(if has_view { show_nothing } else { show_line });
        Ok(())
    }
}

/// What a command for a run of this config must have behind it.
pub(super) fn allowance(config: &Config) -> &'static str {
    if config.environment.command().is_some() { " --allow-command" } else { "" }
}

/// Allows a config that the user has given to start its program, if it has one, and asks the program for its task. A
/// full-screen view leaves no place for what the program writes.
pub(super) fn ask_task(config: &mut Config, has_view: bool) -> Result<(), Failure> {
    config.environment.allow(if has_view { show_nothing } else { show_line });
    Ok(config.ask_task()?)
}

/// The programs of a study: configs with the same one share its processes.
#[derive(Default)]
pub(super) struct Programs(Vec<(EnvironmentConfig, EnvironmentConfig)>);

impl Programs {
    /// As [`ask_task`], for one config of many.
    pub(super) fn ask_task(&mut self, config: &mut Config) -> Result<(), Failure> {
        let given = config.environment.clone();
        if let Some((_, asked)) = self.0.iter().find(|(other, _)| *other == given) {
            config.environment = asked.clone();
            return Ok(config.ask_task()?);
        }
        ask_task(config, false)?;
        self.0.push((given, config.environment.clone()));
        Ok(())
    }

    /// As [`AllowCommand::permit`], for one environment of many.
    pub(super) fn permit(
        &mut self,
        allow: AllowCommand,
        environment: &mut EnvironmentConfig,
        file: &str,
    ) -> Result<(), String> {
        let given = environment.clone();
        if let Some((_, allowed)) = self.0.iter().find(|(other, _)| *other == given) {
            *environment = allowed.clone();
            return Ok(());
        }
        allow.permit(environment, file, false)?;
        self.0.push((given, environment.clone()));
        Ok(())
    }
}

/// Shows a line of the standard error of a program.
fn show_line(program: &str, line: &str) -> bool {
    let mut stderr = io::stderr().lock();
    // The line takes the place of a progress bar, which is drawn again below it.
    let erase = if stderr.is_terminal() { "\r\x1b[2K" } else { "" };
    // A closed stderr leaves nobody to tell.
    writeln!(stderr, "{erase}[{}] {}", escaped(program), escaped(line)).is_ok()
}

fn show_nothing(_: &str, _: &str) -> bool {
    false
}

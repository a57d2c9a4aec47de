//! `cartpole-dqn completions`

use clap::{Args, CommandFactory};
use clap_complete::Shell;

use super::{Failure, print};

/// Print a script with which a shell completes commands and options.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: cartpole-dqn completions bash > ~/.local/share/bash-completion/completions/cartpole-dqn"
)]
pub(super) struct Arguments {
    /// The shell
    shell: Shell,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut super::Arguments::command(), "cartpole-dqn", &mut script);
    print(&String::from_utf8_lossy(&script))
}

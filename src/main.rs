//! `cartpole-dqn`: see the library's documentation and the README.

use std::process::ExitCode;

fn main() -> ExitCode {
    cartpole_dqn::cli::run()
}

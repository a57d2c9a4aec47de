//! `cartpole-dqn`: see the library's documentation and the README.

fn main() -> std::process::ExitCode {
    cartpole_dqn::cli::run()
}

//! `cartpole-dqn config`

use std::fmt::Write;

use clap::{Args, Subcommand};

use super::layers::Layers;
use super::ui::{Failure, print, print_json};
use crate::config::{Config, Setting, schema};

/// Explain configs: print every key with its meaning, or the JSON Schema.
#[derive(Debug, Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Show(Show),
    /// Print the JSON Schema of config files, with which editors complete and check them.
    #[command(after_help = "Example: cartpole-dqn config schema > configs/schema.json")]
    Schema,
}

/// Print the config that `train` would use with the same options: every key, what it means and its default.
///
/// Every line that is not indented can be given to --set.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn config show --config configs/tutorial.json --set gamma=0.99")]
struct Show {
    #[command(flatten)]
    layers: Layers,
    /// Print the config as JSON, and nothing else, on standard output; the output is a valid --config
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: Arguments) -> Result<(), Failure> {
    match arguments.command {
        Command::Show(Show { layers, json }) => {
            let config = layers.resolve()?;
            if json { print_json(&config) } else { print(&describe(&config)) }
        }
        Command::Schema => {
            let schema = serde_json::to_string_pretty(&schema());
            print(&(schema.map_err(|error| Failure::Failed(error.to_string()))? + "\n"))
        }
    }
}

fn describe(config: &Config) -> String {
    let mut text = String::new();
    for Setting { path, value, default, meaning, allowed } in config.settings() {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{path}={value}\n    {meaning}\n    default: {default}; allowed: {allowed}");
    }
    text
}

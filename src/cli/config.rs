//! `cartpole-dqn config`

use clap::{Args, Subcommand};

use super::ui::{Failure, print, print_json};
use crate::config::{Config, SHIPPED, Setting, schema};

/// Print the configs that come with the program, every key with its meaning, or the JSON Schema.
#[derive(Debug, Args)]
pub(super) struct ConfigArguments {
    #[command(subcommand)]
    command: ConfigCommand,
}

#[derive(Debug, Subcommand)]
enum ConfigCommand {
    /// Print the names of the configs that come with the program, as --config takes them.
    #[command(after_help = "Example: cartpole-dqn train --config tutorial
To change more than a few keys: cartpole-dqn config show --config tutorial --json > mine.json")]
    List,
    Show(Show),
    /// Print the JSON Schema of config files, with which editors complete and check them.
    #[command(after_help = "Example: cartpole-dqn config schema > configs/schema.json")]
    Schema,
}

/// Print the config that `train` would use with the same options: every key, what it means and its default.
///
/// Every line that is not indented can be given to --set.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn config show --config tutorial --set gamma=0.99")]
struct Show {
    #[command(flatten)]
    layers: super::layers::Layers,
    /// Print the config as JSON, and nothing else, on standard output; the output is a valid --config
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: ConfigArguments) -> Result<(), Failure> {
    match arguments.command {
        ConfigCommand::List => print(
            &SHIPPED.iter().map(|config| format!("{:25}{}\n", config.name, config.about)).collect::<String>(),
        ),
        ConfigCommand::Show(Show { layers, json }) => {
            let config = layers.resolve()?;
            if json { print_json(&config) } else { print(&describe(&config)) }
        }
        ConfigCommand::Schema => print(&format!("{:#}\n", schema())),
    }
}

fn describe(config: &Config) -> String {
    let line = |Setting { path, value, default, meaning, allowed }| {
        format!("{path}={value}\n    {meaning}\n    default: {default}; allowed: {allowed}\n")
    };
    config.settings().into_iter().map(line).collect()
}

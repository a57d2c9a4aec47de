//! What a config is made of on the command line.

use std::path::{Path, PathBuf};

use super::ui::Failure;
use crate::config::{self, Config};

pub(super) const DEFAULT_NAME: &str = "cartpole";

/// What a config is made of.
#[derive(Debug, clap::Args)]
pub(super) struct Layers {
    /// Settings of the run: a name that `config list` prints, a JSON file, or `-` for standard input [default: cartpole]
    #[arg(long, value_name = "NAME|FILE")]
    config: Option<PathBuf>,
    /// Seed of the run's random numbers, 0 to 2⁶⁴−1; takes precedence over --config and --set
    #[arg(long, value_name = "N", value_parser = super::ui::seed, allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Set one config key, for example optimizer.learning_rate=0.001; may be repeated (`config show` lists the keys)
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// End the run at the first evaluation that solves the task; short for --set stop_when_solved=true
    #[arg(long)]
    stop_when_solved: bool,
}

/// The name of a config in messages, and its text. A name without a path is first a shipped config's; `-` is standard input.
pub(super) fn read_config(path: &Path) -> Result<(String, String), Failure> {
    if let Some(Ok((name, text))) = path.to_str().map(config::shipped) {
        return Ok((name.into(), text.into()));
    }
    if path.as_os_str() != "-" {
        return Ok((crate::text::shown(path), config::read_file(path)?));
    }
    let name = "standard input";
    let text = config::read(std::io::stdin().lock())
        .map_err(|source| config::ConfigError::Read { path: name.into(), source })?;
    Ok((name.into(), text))
}

/// What a run or a trial is called after its config file.
pub(super) fn config_name(path: &Path) -> String {
    match path.file_stem() {
        Some(stem) if path.as_os_str() != "-" => stem.to_string_lossy().into_owned(),
        _ => "stdin".into(),
    }
}

impl Layers {
    /// Defaults < file < `--set` < `--seed`.
    pub(super) fn resolve(&self) -> Result<Config, Failure> {
        let file = self.config.as_deref().map(read_config).transpose()?;
        let layer = file.as_ref().map(|(name, text)| (name.as_str(), text.as_str()));
        Ok(Config::from_layers(layer, &self.sets())?)
    }

    /// `--set` < `--seed`, `--stop-when-solved`.
    pub(super) fn sets(&self) -> Vec<String> {
        let seed = self.seed.map(|seed| format!("seed={seed}"));
        let stop = self.stop_when_solved.then(|| "stop_when_solved=true".to_owned());
        self.set.iter().cloned().chain(seed).chain(stop).collect()
    }

    pub(super) fn name(&self) -> String {
        self.config.as_deref().map_or_else(|| DEFAULT_NAME.into(), config_name)
    }
}

//! Many runs: every config of a study with every seed, on all cores, one file per trial.
//!
//! A trial is a function of its config and seed alone, so the directory that a study leaves depends neither on the number
//! of threads nor on how often it was stopped on the way.

mod folder;
mod trial;

use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};
use std::thread;

use serde::{Deserialize, Serialize};

use crate::config::Config;
use crate::env::{EnvironmentError, Make, Spec};

pub use folder::{StudyDir, StudyError, finished_seeds, read_trial, trial_path};
pub use trial::{ENDURANCE_STEPS, PolicyScore, SCORE_EPISODES, Trial};

/// Version of the files of a study.
pub const FORMAT_VERSION: u32 = 1;

/// What a study runs. Serialised it is the manifest, `study.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Study {
    /// [`FORMAT_VERSION`].
    pub format_version: u32,
    /// The program's version: another one may train with other bits.
    pub version: String,
    /// The configs, each with a name of its own.
    pub configs: Vec<NamedConfig>,
    /// The seeds that each config is trained with.
    pub seeds: Range<u64>,
    /// Whether policies are scored over [`ENDURANCE_STEPS`] steps too.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub endurance: bool,
}

/// One config of a study.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct NamedConfig {
    /// How reports call it.
    pub name: String,
    /// The config; its seed is 0, and each trial puts its own there.
    pub config: Config,
    /// What is known of its task: a report needs the thresholds, and starts no environment.
    pub task: Spec,
}

impl NamedConfig {
    /// The config in its own environment.
    ///
    /// # Errors
    /// When the environment is a program that was not asked for its task.
    pub fn new(name: String, config: Config) -> Result<Self, EnvironmentError> {
        Ok(Self { name, task: config.environment.spec()?, config })
    }
}

impl Study {
    /// A study of configs with different names.
    pub fn new(mut configs: Vec<NamedConfig>, seeds: Range<u64>, endurance: bool) -> Self {
        configs.iter_mut().for_each(|named| named.config.seed = 0);
        Self {
            format_version: FORMAT_VERSION,
            version: env!("CARGO_PKG_VERSION").into(),
            configs,
            seeds,
            endurance,
        }
    }

    /// Every trial as (index of its config, seed): the configs take turns, so that an unfinished study compares them on
    /// the same seeds.
    pub fn trials(&self) -> impl Iterator<Item = (usize, u64)> {
        self.seeds.clone().flat_map(|seed| (0..self.configs.len()).map(move |config| (config, seed)))
    }
}

impl StudyDir {
    /// Runs the trials that have no file yet on `jobs` threads and shows each to `done`, in the order in which they end.
    /// Once `stop` is set, no trial begins, and those that have begun are dropped without a file.
    ///
    /// # Errors
    /// When a trial cannot be written; trials that have begun are still finished. A trial that fails is no error.
    pub fn run(
        &self,
        study: &Study,
        jobs: usize,
        stop: &AtomicBool,
        done: impl FnMut(&Trial),
    ) -> Result<(), StudyError> {
        self.run_in(study, &|config| config.make(), jobs, stop, done)
    }

    /// As [`Self::run`], in the environments that `make` has for the configs.
    ///
    /// # Errors
    /// See there.
    pub fn run_in(
        &self,
        study: &Study,
        make: &(dyn Fn(&Config) -> Arc<Make> + Sync),
        jobs: usize,
        stop: &AtomicBool,
        mut done: impl FnMut(&Trial),
    ) -> Result<(), StudyError> {
        let pending: Vec<_> = study.trials().filter(|&trial| !self.has(trial)).collect();
        let next = AtomicUsize::new(0);
        let failed = AtomicBool::new(false);
        let (sender, finished) = mpsc::channel();
        thread::scope(|scope| {
            for _ in 0..jobs.min(pending.len()) {
                let sender = sender.clone();
                scope.spawn(|| {
                    let sender = sender;
                    while !failed.load(Ordering::Relaxed)
                        && let Some(&(config, seed)) = pending.get(next.fetch_add(1, Ordering::Relaxed))
                        && let named = &study.configs[config]
                        && let Some(trial) =
                            Trial::run(named, make(&named.config), seed, study.endurance, stop)
                    {
                        let written = self.write((config, seed), &trial).map(|()| trial);
                        // The receiver outlives the threads.
                        let _ = sender.send(written);
                    }
                });
            }
            drop(sender);
            let mut result = Ok(());
            for written in finished {
                match written {
                    Ok(trial) => done(&trial),
                    Err(error) => {
                        failed.store(true, Ordering::Relaxed);
                        result = result.and(Err(error));
                    }
                }
            }
            result
        })
    }
}

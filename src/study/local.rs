//! Runs trials of a study on threads of this process.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};

use super::store::{CHECKPOINT, TrialWriter};
use super::{Study, StudyDir, StudyError, Trial, Unended};

pub(crate) type MakeFor = dyn Fn(&crate::config::Config) -> Arc<crate::env::Make> + Sync;

impl StudyDir {
    /// Runs these trials on `jobs` threads, in environments of `make`, and shows each to `done`. Once `stop` is set, none begins,
    /// and unfinished ones write a checkpoint. A trial that cannot be written sets it; one that diverges or stops is no error.
    pub fn run(
        &self, trials: &[(usize, u64)], make: &MakeFor, jobs: usize, stop: &AtomicBool,
        mut done: impl FnMut(&Result<Trial, Unended>),
    ) -> Result<(), StudyError> {
        if trials.is_empty() {
            return Ok(());
        }
        let mut writer = TrialWriter::new(self)?;
        let next = AtomicUsize::new(0);
        let (sender, finished) = mpsc::channel();
        std::thread::scope(|scope| {
            for _ in 0..jobs.min(trials.len()) {
                let sender = sender.clone();
                scope.spawn(|| {
                    let sender = sender;
                    while !stop.load(Ordering::Relaxed)
                        && let Some(&number) = trials.get(next.fetch_add(1, Ordering::Relaxed))
                        && sender.send((number, self.run_trial(number, make, stop))).is_ok()
                    {
                    }
                });
            }
            drop(sender);
            for (number, ended) in finished {
                match &ended {
                    Ok(trial) => {
                        // After an error the file may end in the middle of a line, and nothing may follow.
                        writer.append(trial).inspect_err(|_| stop.store(true, Ordering::Relaxed))?;
                        self.forget_unfinished(number);
                    }
                    Err(unended) => self.record_last_try(number, &unended.cause.to_string()),
                }
                done(&ended);
            }
            writer.finish()
        })
    }

    fn run_trial(&self, number: (usize, u64), make: &MakeFor, stop: &AtomicBool) -> Result<Trial, Unended> {
        let named = &self.study.configs[number.0];
        let (make, unfinished) = (make(&named.config), self.unfinished(number, CHECKPOINT));
        self.forget_last_try(number);
        Trial::run(named, make, number.1, self.study.lasting, Some((&self.directory, &unfinished)), stop)
    }

    /// Runs the first trial and keeps nothing of it.
    pub(crate) fn try_first(&self, stop: &AtomicBool) -> Result<Trial, Unended> {
        let Study { configs, seeds, lasting, .. } = &self.study;
        let named = &configs[0];
        Trial::run(named, named.config.make(), seeds.start, *lasting, None, stop)
    }
}

//! `study --plan` and `study DIR --status`: what there is to do, and what is done of it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use super::ui::{Failure, note, program};
use crate::study::{Cause, Finished, Omitted, StudyDir, Unended};
use crate::text::{labels, legend, shell_word, table, visible};

const NAME: usize = 48;
/// The first trial of a plan is timed no longer than that.
const TIMED: Duration = Duration::from_secs(30);
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// How long a shard should take on one core: schedulers want jobs of an hour, and not of a second.
const SHARD_SECONDS: f64 = 3600.0;
/// Most shards that are proposed: as many as every Slurm takes in one array by default.
const MAX_SHARDS: f64 = 1000.0;

/// What a study costs, and how it is given to the engines of a cluster. Times its first trial, until `stop` is set.
pub(super) fn estimate(dir: &StudyDir, path: &std::path::Path, stop: &AtomicBool) -> Result<String, Failure> {
    let total = dir.study.total();
    let (seconds, is_whole) = time_first_trial(dir, stop)?;
    let core_seconds = seconds * total as f64;
    let shards = (core_seconds / SHARD_SECONDS).ceil().min(total as f64).clamp(1.0, MAX_SHARDS);
    let (last, least) = (shards - 1.0, if is_whole { "about" } else { "more than" });
    let hours = |seconds: f64| format!("{:.2}", seconds / 3600.0);
    let path = shell_word(&path.to_string_lossy());
    let study = visible(&format!("{} study {path}", program()));
    let (configs, seeds) = (dir.study.configs.len(), dir.study.seeds.end - dir.study.seeds.start);
    let [all_hours, shard_hours] = [core_seconds, core_seconds / shards].map(hours);
    Ok(format!(
        "study      {path}\n\
         trials     {total}: configs {configs}, seeds {seeds}\n\
         estimate   {least} {seconds:.2} s a trial on one core, {all_hours} core hours in all, by the first trial\n\
         shards     {shards}, each {least} {shard_hours} hours on one core\n\n\
         By one of these, with the scripts of this program's repository:\n\
         Slurm         sbatch --array=0-{last} scripts/cluster/slurm.sbatch {path} {shards}\n\
         HyperQueue    hq submit --array 0-{last} scripts/cluster/hyperqueue.sh {path} {shards}\n\
         GNU parallel  scripts/cluster/parallel.sh {path} {shards}\n\
         this machine  {study}\n\n\
         progress   {study} --status\n"
    ))
}

/// Seconds of the first trial, and whether that is all of it.
fn time_first_trial(dir: &StudyDir, stop: &AtomicBool) -> Result<(f64, bool), Failure> {
    let begin = Instant::now();
    let end_early = AtomicBool::new(false);
    let trial = thread::scope(|scope| {
        let trial = scope.spawn(|| dir.try_first(&end_early));
        while !trial.is_finished() && begin.elapsed() < TIMED && !stop.load(Ordering::Relaxed) {
            thread::sleep(POLL_INTERVAL);
        }
        end_early.store(true, Ordering::Relaxed);
        trial.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    });
    match trial {
        Err(ended @ Unended { cause: Cause::Failed(_), .. }) => Err(Failure::Disturbed(ended.to_string())),
        trial => Ok((begin.elapsed().as_secs_f64(), trial.is_ok())),
    }
}

pub(super) fn status(dir: &StudyDir) -> Result<String, Failure> {
    let study = &dir.study;
    let mut counts = vec![(0, 0); study.configs.len()];
    let Omitted { notes, last_tries } = dir.read(|Finished { config, trial }| {
        let (done, failed) = &mut counts[config];
        *done += 1;
        *failed += u64::from(trial.error.is_some());
        Ok(())
    })?;
    notes.iter().for_each(|text| note(text));
    let seeds = study.seeds.end - study.seeds.start;
    let row = |number: String, name: &str, (done, failed): (u64, u64), seeds: u64| {
        vec![number, name.into(), done.to_string(), (seeds - done).to_string(), failed.to_string()]
    };
    let mut rows = vec![["", "config", "done", "missing", "failed"].map(String::from).to_vec()];
    let names: Vec<&str> = study.configs.iter().map(|named| named.name.as_str()).collect();
    let labels = labels(&names, NAME);
    let numbered = labels.iter().zip(&counts).enumerate();
    rows.extend(numbered.map(|(i, (label, &count))| row(i.to_string(), label, count, seeds)));
    let all = counts.iter().fold((0, 0), |all, count| (all.0 + count.0, all.1 + count.1));
    rows.push(row(String::new(), "all", all, study.total()));
    let names = legend(labels.iter().map(String::as_str).zip(names));
    Ok(names + &table(&rows) + &crate::report::describe_last_tries(last_tries))
}

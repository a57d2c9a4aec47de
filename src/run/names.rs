//! The names of the files in the directory of a run or a study: their one home.

pub(crate) const CONFIG: &str = "config.json";
/// What the run was started as, and whether it has failed.
pub(crate) const ABOUT: &str = "run.json";
pub(crate) const METRICS: &str = "metrics.jsonl";
/// A table of events that earlier versions wrote.
pub(crate) const PROGRESS: &str = "progress.csv";
pub(crate) const SUMMARY: &str = "summary.json";
pub(crate) const CHECKPOINTS: &str = "checkpoints";
pub(crate) const TENSORBOARD: &str = "tensorboard";

pub(crate) const BEST: &str = "best.safetensors";
pub(crate) const LAST: &str = "last.safetensors";
/// The periodic checkpoint before the last one.
pub(crate) const PREVIOUS: &str = "previous.safetensors";
/// The weights that a run began with, where they were not drawn.
pub(crate) const INIT: &str = "init.safetensors";

pub(crate) const MANIFEST: &str = "study.json";

/// The report of a run or a study, for programs.
pub(crate) const REPORT: &str = "report.json";
/// Its table of evaluations.
pub(crate) const EVALUATIONS: &str = "evaluations.csv";
pub(crate) const PAGE: &str = "report.html";
/// Its plots: those of a study, and that of a run.
pub(crate) const PLOTS: [&str; 5] = [
    "learning_curves.svg",
    "performance_profile.svg",
    "steps_to_solve.svg",
    "comparison.svg",
    "learning_curve.svg",
];

/// Whether a file of this name belongs to a report.
pub(crate) fn is_of_a_report(name: &std::ffi::OsStr) -> bool {
    [REPORT, EVALUATIONS, PAGE].into_iter().chain(PLOTS).any(|part| name == part)
}

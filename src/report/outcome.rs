//! What a report keeps of the trials of a study: as little as it can, because there may be a million.

use std::sync::Arc;

use super::history;
use crate::env::Spec;
use crate::study::{Finished, NamedConfig, Omitted, PolicyScore, StudyDir, TrialSummary};
use crate::trainer::Evaluation;

pub(super) struct Group {
    pub(super) name: String,
    pub(super) task: Spec,
    pub(super) outcomes: Vec<TrialOutcome>,
}

pub(super) struct TrialOutcome {
    pub(super) seed: u64,
    pub(super) error: Option<Box<str>>,
    /// The environment steps of training, of evaluations and of the tests of `stop_when_lasting_steps`.
    pub(super) steps_played: Option<[u64; 3]>,
    /// The key that ended it before its budget was used up.
    pub(super) stopped_by: Option<&'static str>,
    pub(super) best: Option<PolicyOutcome>,
    pub(super) final_: Option<PolicyOutcome>,
    /// The steps of the evaluations, shared with other trials that have the same.
    pub(super) steps: Arc<[u64]>,
    means: Box<[f64]>,
}

/// Mean return of a policy, and whether it lasts; none where the study does not ask.
#[derive(Clone, Copy, Debug)]
pub(super) struct PolicyOutcome {
    pub(super) mean: f64,
    pub(super) lasts: Option<bool>,
}

/// A policy's mean return; the lowest of the task where a failed run left no policy.
pub(super) fn score(policy: Option<PolicyOutcome>, task: &Spec) -> f64 {
    policy.map_or(task.return_range.0, |policy| policy.mean)
}

impl TrialOutcome {
    /// Shares `steps` with the trial before if both have evaluations at the same steps.
    fn new(Finished { trial, .. }: Finished, steps: &mut Arc<[u64]>) -> Self {
        let own = trial.evaluations.iter().map(|evaluation| evaluation.env_steps);
        if !own.clone().eq(steps.iter().copied()) {
            *steps = own.collect();
        }
        let played = |summary: &TrialSummary| {
            Some([summary.env_steps?, summary.evaluation_steps?, summary.lasting_test_steps?])
        };
        let policy = |score: PolicyScore| PolicyOutcome { mean: score.mean, lasts: score.lasts };
        Self {
            seed: trial.seed,
            best: trial.best.map(policy),
            final_: trial.final_.map(policy),
            steps: Arc::clone(steps),
            steps_played: trial.summary.as_ref().and_then(played),
            stopped_by: trial.summary.and_then(|summary| history::stopped_by(summary.end_reason?)),
            means: trial.evaluations.iter().map(|evaluation| evaluation.mean).collect(),
            error: trial.error.map(String::into_boxed_str),
        }
    }

    pub(super) fn evaluations(&self) -> Vec<Evaluation> {
        self.steps.iter().zip(&self.means).map(|(&env_steps, &mean)| Evaluation { env_steps, mean }).collect()
    }

    pub(super) fn value_at(&self, step: u64, task: &Spec) -> f64 {
        history::value_at(step, &self.steps, &self.means, self.error.is_some(), task)
    }
}

pub(super) fn read(study_dir: &StudyDir) -> Result<(Vec<Group>, Omitted), super::ReportError> {
    let group = |NamedConfig { name, task, .. }: NamedConfig| Group { name, task, outcomes: Vec::new() };
    let mut groups: Vec<Group> = study_dir.study.configs.iter().cloned().map(group).collect();
    let mut steps: Vec<Arc<[u64]>> = vec![Arc::default(); groups.len()];
    let left_out = study_dir.read(|trial| {
        let config = trial.config;
        groups[config].outcomes.push(TrialOutcome::new(trial, &mut steps[config]));
        Ok(())
    })?;
    groups.retain(|group| !group.outcomes.is_empty());
    groups.iter_mut().for_each(|group| group.outcomes.sort_unstable_by_key(|outcome| outcome.seed));
    Ok((groups, left_out))
}

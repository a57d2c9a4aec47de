//! What a report keeps of the trials of a study: as little as it can, because there may be a million.

use std::sync::Arc;

use super::ReportError;
use super::history;
use crate::env::Spec;
use crate::study::{Finished, LeftOut, NamedConfig, PolicyScore, SCORE_EPISODES, StudyDir};
use crate::trainer::Evaluation;

/// The finished trials of a config, in the order of their seeds.
#[derive(Debug)]
pub(super) struct Group {
    pub(super) name: String,
    pub(super) task: Spec,
    pub(super) outcomes: Vec<Outcome>,
}

/// What became of a trial.
#[derive(Debug)]
pub(super) struct Outcome {
    pub(super) seed: u64,
    pub(super) error: Option<Box<str>>,
    /// The key that ended it before its budget was used up.
    pub(super) stopped_by: Option<&'static str>,
    pub(super) best: Option<Score>,
    pub(super) final_: Option<Score>,
    /// The steps of the evaluations; trials of the same steps share them.
    pub(super) steps: Arc<[u64]>,
    means: Box<[f64]>,
}

/// What a policy came to.
#[derive(Debug)]
pub(super) struct Score {
    pub(super) mean: f64,
    endured: Option<u64>,
}

impl Score {
    fn of(policy: &PolicyScore) -> Self {
        Self { mean: policy.mean, endured: policy.endured }
    }

    /// Whether the policy lasts in every episode; none where the study does not ask.
    pub(super) fn endures(&self) -> Option<bool> {
        self.endured.map(|endured| endured == SCORE_EPISODES)
    }
}

impl Outcome {
    /// Takes the `steps` of another trial if they are its own.
    fn new(Finished { trial, .. }: Finished, steps: &mut Arc<[u64]>) -> Self {
        let own = trial.evaluations.iter().map(|evaluation| evaluation.env_steps);
        if !own.clone().eq(steps.iter().copied()) {
            *steps = own.collect();
        }
        Self {
            seed: trial.seed,
            best: trial.best.as_ref().map(Score::of),
            final_: trial.final_.as_ref().map(Score::of),
            steps: Arc::clone(steps),
            stopped_by: trial.summary.and_then(|summary| history::stopped_by(summary.end_reason?)),
            means: trial.evaluations.iter().map(|evaluation| evaluation.mean).collect(),
            error: trial.error.map(String::into_boxed_str),
        }
    }

    /// The evaluations during training.
    pub(super) fn evaluations(&self) -> Vec<Evaluation> {
        let pairs = self.steps.iter().zip(&self.means);
        pairs.map(|(&env_steps, &mean)| Evaluation { env_steps, mean }).collect()
    }

    /// See [`history::value_at`].
    pub(super) fn value_at(&self, step: u64, task: &Spec) -> f64 {
        history::value_at(step, &self.steps, &self.means, self.error.is_some(), task)
    }
}

/// The configs that have finished trials, and what is left out.
pub(super) fn read(study_dir: &StudyDir) -> Result<(Vec<Group>, LeftOut), ReportError> {
    let named = study_dir.study().configs.iter();
    let group = |NamedConfig { name, task, .. }: &NamedConfig| Group {
        name: name.clone(),
        task: task.clone(),
        outcomes: Vec::new(),
    };
    let mut groups: Vec<Group> = named.map(group).collect();
    let mut steps: Vec<Arc<[u64]>> = vec![Arc::default(); groups.len()];
    let left_out = study_dir.read(|trial| {
        let config = trial.config;
        groups[config].outcomes.push(Outcome::new(trial, &mut steps[config]));
        Ok(())
    })?;
    groups.retain(|group| !group.outcomes.is_empty());
    groups.iter_mut().for_each(|group| group.outcomes.sort_unstable_by_key(|outcome| outcome.seed));
    Ok((groups, left_out))
}

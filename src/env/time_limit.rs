//! A limit on the length of an episode, outside the physics (Pardo et al. 2018, "Time limits in reinforcement
//! learning"): it truncates, it does not terminate.

use super::{Answer, Environment, Image, Outcome, Spec, Start, VectorEnvironment};

/// Truncates the episodes of `E` after `max_steps` steps. An inner environment that truncates its own episodes still does.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeLimit<E> {
    max_steps: u32,
    elapsed_steps: u32,
    environment: E,
}

impl<E> TimeLimit<E> {
    pub fn new(environment: E, max_steps: u32) -> Self {
        Self { environment, max_steps, elapsed_steps: 0 }
    }
}

impl<E: Environment> Environment for TimeLimit<E> {
    fn spec(&self) -> &Spec {
        self.environment.spec()
    }

    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()> {
        self.elapsed_steps = 0;
        self.environment.reset(start, observation)
    }

    fn step(&mut self, action: usize, observation: &mut [f32]) -> Answer<Outcome> {
        self.elapsed_steps += 1;
        let outcome = self.environment.step(action, observation)?;
        Ok(Outcome { truncated: outcome.truncated || self.elapsed_steps >= self.max_steps, ..outcome })
    }

    fn state(&self) -> Option<&[f64]> {
        self.environment.state()
    }

    fn ending(&self) -> &'static str {
        self.environment.ending()
    }

    fn scene(&self) -> Option<super::scene::Scene> {
        self.environment.scene()
    }

    fn image(&mut self) -> Answer<Option<Image>> {
        self.environment.image()
    }

    fn vector(&self, max_steps: u32) -> Option<Box<dyn VectorEnvironment>> {
        self.environment.vector(self.max_steps.min(max_steps))
    }

    fn processes(&self) -> Option<usize> {
        self.environment.processes()
    }
}

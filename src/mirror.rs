//! The mirror image of a task.

/// Under which exchange of coordinates and actions a task is its own mirror image: the step from the image of s with
/// the image of a leads to the image of s′, with the same reward and the same end (van der Pol et al. 2020, "MDP
/// homomorphic networks", whose first example is CartPole).
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Mirror {
    /// Coordinate i of the image is `factor` times coordinate j, where (j, `factor`) stands at place i.
    pub observation: Vec<(usize, f32)>,
    /// The image of action a is `actions[a]`.
    pub actions: Vec<u8>,
}

impl Mirror {
    /// Whether this is the mirror of a task with such sizes. Its own image is no other than the original.
    pub(crate) fn fits(&self, observation_size: usize, num_actions: usize) -> bool {
        let image = |&(j, factor): &(usize, f32)| {
            let (i, back) = *self.observation.get(j)?;
            (factor * back == 1.0).then_some(i)
        };
        let action = |&action: &u8| self.actions.get(usize::from(action)).copied().map(usize::from);
        self.observation.len() == observation_size
            && self.actions.len() == num_actions
            && self.observation.iter().enumerate().all(|(i, pair)| image(pair) == Some(i))
            && self.actions.iter().enumerate().all(|(i, pair)| action(pair) == Some(i))
    }

    pub fn reflect(&self, observation: &[f32]) -> Vec<f32> {
        self.observation.iter().map(|&(from, factor)| factor * observation[from]).collect()
    }

    /// The same mirror for observations whose coordinates have been divided by `divisors`.
    pub fn of_divided(&self, divisors: &[f32]) -> Self {
        let mut mirror = self.clone();
        for (i, (j, factor)) in mirror.observation.iter_mut().enumerate() {
            *factor *= divisors[*j] / divisors[i];
        }
        mirror
    }
}

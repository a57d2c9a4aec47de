//! Tabular Q-learning (Watkins 1989, "Learning from delayed rewards"; Sutton and Barto 2018, section 6.5).

use serde::{Deserialize, Serialize};

use super::{
    Agent, Counters, EpsilonGreedy, Exploration, NamedNumbers, NotFinite, Played, Policy, Probes, QTable,
    Transition,
};
use crate::mirror::Mirror;
use crate::rng::{Rng, Stream};
use crate::tensors::{TensorError, Tensors};

/// Settings of [`QLearning`]. Each is a key of the config, see `config::keys`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct QTableConfig {
    pub table: TableConfig,
    pub optimizer: crate::nn::LearningRate,
    pub gamma: f64,
    pub exploration: Exploration,
}

/// The cells of the table, and how it starts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableConfig {
    pub bins: Vec<Bins>,
    /// Between which values the equal cells of each coordinate lie.
    pub low: Vec<f64>,
    pub high: Vec<f64>,
    pub(crate) initial: f64,
    /// Whether the table also learns from the mirror image of each transition.
    pub mirror: bool,
}

/// The cells of a coordinate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Bins {
    /// So many equal ones.
    Equal(usize),
    /// Those between these edges, in ascending order.
    Edges(Vec<f64>),
}

impl Bins {
    pub fn count(&self) -> usize {
        match self {
            Self::Equal(count) => *count,
            Self::Edges(edges) => edges.len() + 1,
        }
    }

    fn edges(&self, low: f64, high: f64) -> Vec<f32> {
        match self {
            Self::Equal(count) => {
                (1..*count).map(|k| (low + (high - low) * k as f64 / *count as f64) as f32).collect()
            }
            Self::Edges(edges) => edges.iter().map(|&edge| edge as f32).collect(),
        }
    }
}

impl TableConfig {
    pub fn edges(&self) -> Vec<Vec<f32>> {
        let ranges = self.low.iter().zip(&self.high);
        self.bins.iter().zip(ranges).map(|(bins, (&low, &high))| bins.edges(low, high)).collect()
    }
}

#[derive(Clone, Debug)]
pub struct QLearning {
    config: QTableConfig,
    mirror: Option<Mirror>,
    table: QTable,
    exploration: EpsilonGreedy,
    learning_rate: f64,
    updates: u64,
    td_error: f32,
    /// The largest change of a value in the current episode, and in the one before it.
    largest_update: [f32; 2],
}

impl QLearning {
    /// An agent that knows nothing yet, its stream spawned from `seed`. With `table.mirror` it also learns from the image of
    /// every transition in `mirror`, the mirror image of the task.
    pub fn new(config: QTableConfig, num_actions: usize, mirror: Option<&Mirror>, seed: u64) -> Self {
        Self {
            mirror: mirror.filter(|_| config.table.mirror).cloned(),
            table: QTable::new(config.table.edges(), num_actions, config.table.initial as f32),
            exploration: EpsilonGreedy::new(config.exploration, Rng::spawn(seed, Stream::Explore)),
            learning_rate: config.optimizer.after(0),
            updates: 0,
            td_error: 0.0,
            largest_update: [0.0; 2],
            config,
        }
    }

    fn learn(&mut self, transition: Transition<'_>) {
        let (alpha, gamma) = (self.learning_rate as f32, self.config.gamma as f32);
        self.td_error = self.table.update(transition, alpha, gamma);
        self.updates += 1;
        self.largest_update[0] = self.largest_update[0].max((alpha * self.td_error).abs());
    }

    fn apply_schedules(&mut self, env_steps: u64) {
        self.learning_rate = self.config.optimizer.after(env_steps);
        self.exploration.after_step(env_steps);
    }
}

impl Agent for QLearning {
    /// ε-greedy: a random action, or else the one with the largest Q-value, the first of equals.
    fn act(&mut self, observation: &[f32]) -> usize {
        if let Some(action) = self.exploration.explore(self.table.num_actions()) {
            return action;
        }
        let q = self.table.q_values(observation);
        (1..q.len()).fold(0, |best, action| if q[action] > q[best] { action } else { best })
    }

    /// Learns from the transition at once, and then forgets it.
    fn observe(&mut self, transition: Transition<'_>) {
        if let Some(mirror) = &self.mirror {
            let observation = &mirror.reflect(transition.observation);
            let next_observation = &mirror.reflect(transition.next_observation);
            let action = usize::from(mirror.actions[transition.action]);
            self.learn(Transition { observation, action, next_observation, ..transition });
        }
        self.learn(transition);
    }

    /// Returns the squared TD error of the latest step.
    fn learn_if_due(&mut self, env_steps: u64) -> Result<Option<f32>, NotFinite> {
        self.apply_schedules(env_steps);
        let loss = self.td_error * self.td_error;
        if loss.is_finite() { Ok(Some(loss)) } else { Err(NotFinite::Loss) }
    }

    fn end_episode(&mut self, _episode: u64) {
        self.exploration.after_episode();
        self.largest_update = [0.0, self.largest_update[0]];
    }

    fn policy(&self) -> Policy {
        Policy::Table(self.table.clone())
    }

    fn start_from(&mut self, policy: &Policy) -> bool {
        let Policy::Table(table) = policy else { return false };
        self.table.start_from(table)
    }

    fn gamma(&self) -> f64 {
        self.config.gamma
    }

    fn counters(&self) -> Counters {
        let Self { updates, learning_rate, .. } = *self;
        Counters { updates, epsilon: self.exploration.epsilon, learning_rate }
    }

    fn statistics(&self, probes: &Probes, played: &[Played]) -> Option<NamedNumbers> {
        let (cells, visited) = self.table.visited_cells();
        let [ordinary, doomed] = [&probes.ordinary, &probes.doomed].map(|observations| {
            let mut q = nalgebra::DMatrix::zeros(observations.len(), self.table.num_actions());
            self.table.forward(observations.iter().map(Vec::as_slice), &mut q);
            q
        });
        let inside = [
            ("visited_share", visited as f64 / cells as f64),
            ("visits_per_cell", self.updates as f64 / visited.max(1) as f64),
            ("largest_update", f64::from(self.largest_update[1])),
        ];
        let values = super::statistics::value_statistics(&ordinary, &doomed, 1.0, played);
        (self.updates > 0).then(|| NamedNumbers::new(values.into_iter().chain(inside)))
    }

    fn weights_sha256(&self) -> String {
        self.table.sha256()
    }

    /// The table itself is the policy, which stands beside it without a prefix.
    fn save(&self, tensors: &mut Tensors) {
        self.exploration.save(tensors);
        tensors.put("largest_update", &[2], &self.largest_update);
    }

    fn load(&mut self, tensors: &Tensors, env_steps: u64) -> Result<(), TensorError> {
        self.table.load("", tensors)?;
        self.updates = self.table.updates();
        if self.updates >= 1 << 62 {
            return Err(TensorError::Inconsistent("number of updates"));
        }
        self.exploration.load(tensors, self.table.num_actions())?;
        let largest_update = tensors.get("largest_update", &[2])?;
        self.largest_update.copy_from_slice(&largest_update);
        self.apply_schedules(env_steps);
        Ok(())
    }
}

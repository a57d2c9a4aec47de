//! A table of Q-values over the cells of a grid.

use nalgebra::DMatrix;

use super::Transition;
use crate::tensors::{Element, TensorError, Tensors, sha256};

/// Name of the tensor with the values, and how those with the edges and the visits begin.
const VALUES: &str = "q_table";
const EDGES: &str = "table.edges.";
const VISITS: &str = "table.visits";

/// Q(s, a) for every cell of a grid over the observations. An observation belongs to cell k of a coordinate if k of the
/// coordinate's inner edges are not above it; the outermost cells have no outer edge.
#[derive(Clone, Debug, PartialEq)]
pub struct QTable {
    /// The inner edges of each coordinate, in ascending order.
    edges: Vec<Vec<f32>>,
    num_actions: usize,
    /// (cells, actions), the last coordinate's cells next to each other.
    values: Vec<f32>,
    /// How often each value was updated.
    visits: Vec<u64>,
}

impl QTable {
    pub fn new(edges: Vec<Vec<f32>>, num_actions: usize, initial: f32) -> Self {
        let size = edges.iter().map(|edges| edges.len() + 1).product::<usize>() * num_actions;
        Self { edges, num_actions, values: vec![initial; size], visits: vec![0; size] }
    }

    /// One step of Q-learning (Watkins 1989; Sutton and Barto 2018, equation 6.8). Returns the TD error, the bracket:
    ///
    /// ```text
    /// Q(s, a) ← Q(s, a) + α [r + γ max Q(s′, ·) − Q(s, a)]
    /// ```
    ///
    /// What follows a termination is worth nothing.
    pub fn update(&mut self, transition: Transition<'_>, alpha: f32, gamma: f32) -> f32 {
        let Transition { observation, action, reward, next_observation, terminated, .. } = transition;
        let place = self.place(observation) + action;
        let next_q = self.q_values(next_observation).iter();
        let max_next = next_q.fold(f32::NEG_INFINITY, |max, &q| if q > max { q } else { max });
        let td_target = if terminated { reward } else { reward + gamma * max_next };
        let td_error = td_target - self.values[place];
        self.values[place] += alpha * td_error;
        self.visits[place] += 1;
        td_error
    }

    pub fn q_values(&self, observation: &[f32]) -> &[f32] {
        &self.values[self.place(observation)..][..self.num_actions]
    }

    /// How often the values of each action were updated.
    pub fn visits(&self, observation: &[f32]) -> &[u64] {
        &self.visits[self.place(observation)..][..self.num_actions]
    }

    /// Where the values of an observation's cell begin.
    fn place(&self, observation: &[f32]) -> usize {
        let cell = self.edges.iter().zip(observation).fold(0, |cell, (edges, &value)| {
            cell * (edges.len() + 1) + edges.partition_point(|&edge| edge <= value)
        });
        cell * self.num_actions
    }

    pub(crate) fn bins(&self) -> Vec<usize> {
        self.edges.iter().map(|edges| edges.len() + 1).collect()
    }

    pub fn edges(&self) -> &[Vec<f32>] {
        &self.edges
    }

    /// Number of cells, and how many of them were ever updated.
    pub fn visited_cells(&self) -> (usize, usize) {
        let cells = self.visits.chunks_exact(self.num_actions);
        (cells.len(), cells.filter(|visits| visits.iter().any(|&count| count > 0)).count())
    }

    pub fn updates(&self) -> u64 {
        self.visits.iter().fold(0, |sum, &count| sum.saturating_add(count))
    }

    /// Takes over the values of another table, as if they had not been updated yet. False if it has other cells.
    #[must_use]
    pub(crate) fn start_from(&mut self, other: &Self) -> bool {
        let fits = self.edges == other.edges && self.num_actions == other.num_actions;
        if fits {
            self.values.clone_from(&other.values);
        }
        fits
    }

    /// SHA-256 in lower-case hexadecimal over the edges and then the values, as little-endian f32.
    pub fn sha256(&self) -> String {
        sha256(self.edges.iter().chain([&self.values]).map(|numbers| f32::to_bytes(numbers)))
    }

    fn shape(&self) -> Vec<usize> {
        [self.bins(), vec![self.num_actions]].concat()
    }

    /// Whether there is a table in the tensors without a prefix.
    pub(crate) fn is_in(tensors: &Tensors) -> bool {
        tensors.shape(VALUES).is_ok()
    }

    /// Adds the table: `q_table` [bins…, actions], `table.edges.K` for each coordinate and `table.visits`.
    pub fn save(&self, prefix: &str, tensors: &mut Tensors) {
        tensors.put(&format!("{prefix}{VALUES}"), &self.shape(), &self.values);
        tensors.put(&format!("{prefix}{VISITS}"), &self.shape(), &self.visits);
        for (k, edges) in self.edges.iter().enumerate() {
            tensors.put(&format!("{prefix}{EDGES}{k}"), &[edges.len()], edges);
        }
    }

    /// Replaces values and visits by those of a table with the same cells that [`Self::save`] has added.
    pub fn load(&mut self, prefix: &str, tensors: &Tensors) -> Result<(), TensorError> {
        for (k, edges) in self.edges.iter().enumerate() {
            if tensors.get::<f32>(&format!("{prefix}{EDGES}{k}"), &[edges.len()])? != *edges {
                return Err(TensorError::Inconsistent("table of Q-values with its edges"));
            }
        }
        self.visits = tensors.get(&format!("{prefix}{VISITS}"), &self.shape())?;
        self.load_values(&format!("{prefix}{VALUES}"), tensors)
    }

    fn load_values(&mut self, name: &str, tensors: &Tensors) -> Result<(), TensorError> {
        self.values = tensors.get(name, &self.shape())?;
        let is_finite = self.values.iter().all(|value| value.is_finite());
        if is_finite { Ok(()) } else { Err(TensorError::NotFinite(name.into())) }
    }

    /// The table in the tensors without a prefix, for a task with these sizes. Without visits it counts as never updated.
    pub fn from_tensors(tensors: &Tensors, inputs: usize, outputs: usize) -> Result<Self, TensorError> {
        let shape = tensors.shape(VALUES)?.to_vec();
        let Some((&num_actions, bins)) = shape.split_last().filter(|_| !shape.contains(&0)) else {
            return Err(TensorError::NoPolicy);
        };
        if (bins.len(), num_actions) != (inputs, outputs) {
            return Err(TensorError::WrongTable { found: shape, inputs, outputs });
        }
        let mut edges = Vec::new();
        for (k, &bins) in bins.iter().enumerate() {
            let name = format!("{EDGES}{k}");
            let own = tensors.get::<f32>(&name, &[bins - 1])?;
            if !own.iter().all(|edge| edge.is_finite()) || !own.is_sorted_by(|a, b| a < b) {
                return Err(TensorError::EdgesDoNotAscend(name));
            }
            edges.push(own);
        }
        let mut table = Self::new(edges, num_actions, 0.0);
        if tensors.shape(VISITS).is_ok() {
            table.visits = tensors.get(VISITS, &shape)?;
        }
        table.load_values(VALUES, tensors)?;
        Ok(table)
    }

    /// The Q-values of observations in the first rows of `q`, (batch, actions).
    pub(super) fn forward<'a>(&self, observations: impl Iterator<Item = &'a [f32]>, q: &mut DMatrix<f32>) {
        for (sample, observation) in observations.enumerate() {
            for (action, &value) in self.q_values(observation).iter().enumerate() {
                q[(sample, action)] = value;
            }
        }
    }

    pub(crate) fn num_actions(&self) -> usize {
        self.num_actions
    }
}

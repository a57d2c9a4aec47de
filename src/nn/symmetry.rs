//! Networks that are their own mirror image.

use crate::mirror::Mirror;

/// Keeps a network equivariant under the mirror image of its task (van der Pol et al. 2020, "MDP homomorphic networks"): the
/// Q-value of an action is that of the action's image in the image of the state.
///
/// In a hidden layer of h units, unit k and unit k + h/2 are images of each other; inputs and outputs have the images that the
/// task gives them. So each weight has an image too, the weight between the images of its units. The network is equivariant
/// where both are equal, but for the sign with which the mirror reflects an input. It remains a plain network of dense layers.
#[derive(Clone, Debug)]
pub struct Symmetry {
    runs: Vec<Run>,
}

/// `len` parameters from `start`, whose images lie behind them, from `image`.
#[derive(Clone, Debug)]
struct Run {
    start: usize,
    image: usize,
    len: usize,
    /// An image is so many times the original: 1 or −1.
    sign: f32,
}

impl Symmetry {
    /// Whether a network with these hidden layers can be symmetric: there is one, and each has an even number of units.
    pub fn fits(hidden: &[usize]) -> bool {
        !hidden.is_empty() && hidden.iter().all(|units| units.is_multiple_of(2))
    }

    /// The symmetry of a network of these layer sizes, whose hidden layers [fit](Self::fits), for a task with this mirror, which
    /// reflects every coordinate with a factor of 1 or −1.
    pub fn new(sizes: &[usize], mirror: &Mirror) -> Self {
        let last = sizes.len() - 1;
        let image = |layer: usize, unit: usize| match layer {
            0 => mirror.observation[unit],
            _ if layer == last => (usize::from(mirror.actions[unit]), 1.0),
            _ => ((unit + sizes[layer] / 2) % sizes[layer], 1.0),
        };
        let mut images = Vec::new();
        for layer in 0..last {
            let (start, inputs, outputs) = (images.len(), sizes[layer], sizes[layer + 1]);
            for row in 0..=inputs {
                // The row behind the weights holds the biases.
                let (row, sign) = if row < inputs { image(layer, row) } else { (inputs, 1.0) };
                images.extend(
                    (0..outputs).map(|output| (start + row * outputs + image(layer + 1, output).0, sign)),
                );
            }
        }
        let mut runs: Vec<Run> = Vec::new();
        for (start, &(image, sign)) in images.iter().enumerate().filter(|(start, (image, _))| start < image) {
            match runs.last_mut() {
                Some(run) if (run.start + run.len, run.image + run.len, run.sign) == (start, image, sign) => {
                    run.len += 1;
                }
                _ => runs.push(Run { start, image, len: 1, sign }),
            }
        }
        Self { runs }
    }

    /// Makes a network symmetric: one parameter of each pair becomes the image of the other.
    pub fn impose(&self, parameters: &mut [f32]) {
        self.each_pair(parameters, |one, image, sign| *image = sign * *one);
    }

    /// The gradient of a symmetric network by its samples becomes that by its samples and their mirror images: each pair gets
    /// its mean. A step of Adam along it leaves the network symmetric, to the bit.
    pub fn average(&self, gradient: &mut [f32]) {
        self.each_pair(gradient, |one, image, sign| {
            *one = 0.5 * (*one + sign * *image);
            *image = sign * *one;
        });
    }

    /// Whether a network is symmetric.
    pub fn holds(&self, parameters: &[f32]) -> bool {
        let mut symmetric = parameters.to_vec();
        self.impose(&mut symmetric);
        symmetric == parameters
    }

    fn each_pair(&self, parameters: &mut [f32], change: impl Fn(&mut f32, &mut f32, f32)) {
        for &Run { start, image, len, sign } in &self.runs {
            let (ones, images) = parameters.split_at_mut(image);
            for (one, image) in ones[start..start + len].iter_mut().zip(images) {
                change(one, image, sign);
            }
        }
    }
}

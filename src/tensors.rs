//! Named tensors, as PyTorch and NumPy users know them: what agents save and load. They know no files and no runs.

use std::collections::{BTreeMap, HashMap};

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

use crate::nn::{Kernels, Mlp};
use crate::rng::Rng;

const MAX_LAYERS: usize = 64;
const MAX_UNITS: usize = 1 << 16;

const MAX_TENSORS: usize = 4096;

/// The JSON header of a safetensors file, as far as the file goes.
pub(crate) fn header_of(file: &[u8]) -> &[u8] {
    let Some((length, rest)) = file.split_first_chunk() else { return &[] };
    let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
    &rest[..rest.len().min(length)]
}

/// Refuses by its header a file with more tensors than any policy, checkpoint or update: to read them would take long.
pub(crate) fn check_count(header: &[u8]) -> Result<(), String> {
    const FIELD: &[u8] = b"\"data_offsets\"";
    // Each tensor has the field once.
    let is_field = |at: &usize| header[*at..].starts_with(FIELD);
    let quotes = header.iter().enumerate().filter(|(_, byte)| **byte == b'"').map(|(at, _)| at);
    match quotes.filter(is_field).take(MAX_TENSORS + 1).count() {
        count if count > MAX_TENSORS => Err(format!("it has more than {MAX_TENSORS} tensors")),
        _ => Ok(()),
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensors(BTreeMap<String, Tensor>);

#[derive(Clone, Debug, PartialEq)]
struct Tensor {
    dtype: Dtype,
    shape: Vec<usize>,
    /// Little-endian.
    bytes: Vec<u8>,
}

/// What is wrong with a tensor, or with what several of them should be together.
#[derive(Debug, thiserror::Error)]
pub enum TensorError {
    #[error("has no tensor `{0}`")]
    Missing(String),
    #[error("tensor `{name}` is {dtype:?} {shape:?}, expected {expected}")]
    Unexpected { name: String, dtype: Dtype, shape: Vec<usize>, expected: String },
    #[error(
        "holds no policy: the tensors without a prefix must be exactly `0.weight`, `0.bias`, `2.weight`, …, or those of a \
         `q_table` [bins…, actions]. In Python, with the Linear layers of a network in order: save_file({{f\"{{2 * i}}.{{n}}\": \
         getattr(layer, n).detach() for i, layer in enumerate(layers) for n in (\"weight\", \"bias\")}}, \"policy.safetensors\")"
    )]
    NoPolicy,
    #[error(
        "its `q_table` is {found:?}; the task needs a table over {inputs} coordinates with {outputs} actions"
    )]
    WrongTable { found: Vec<usize>, inputs: usize, outputs: usize },
    #[error("tensor `{0}` holds edges that do not ascend")]
    EdgesDoNotAscend(String),
    #[error("its policy has layers {found:?}; the task needs {inputs} inputs and {outputs} outputs")]
    WrongNetwork { found: Vec<usize>, inputs: usize, outputs: usize },
    #[error("tensor `{0}` holds NaN or infinity")]
    NotFinite(String),
    #[error("its {0} is inconsistent")]
    Inconsistent(&'static str),
}

/// A number that tensors consist of.
pub trait Element: Copy {
    const DTYPE: Dtype;
    /// Little-endian bytes.
    fn to_bytes(values: &[Self]) -> Vec<u8>;
    /// The inverse of [`Self::to_bytes`].
    fn from_bytes(bytes: &[u8]) -> Vec<Self>;
}

macro_rules! element {
    ($type:ty, $dtype:ident, $size:literal) => {
        impl Element for $type {
            const DTYPE: Dtype = Dtype::$dtype;
            fn to_bytes(values: &[Self]) -> Vec<u8> {
                values.iter().flat_map(|value| value.to_le_bytes()).collect()
            }
            fn from_bytes(bytes: &[u8]) -> Vec<Self> {
                bytes.as_chunks::<$size>().0.iter().map(|&bytes| Self::from_le_bytes(bytes)).collect()
            }
        }
    };
}

element!(u8, U8, 1);
element!(f32, F32, 4);
element!(f64, F64, 8);
element!(u64, U64, 8);

impl Tensors {
    pub(crate) fn from_safetensors(bytes: &[u8]) -> Result<Self, safetensors::SafeTensorError> {
        let file = SafeTensors::deserialize(bytes)?;
        let tensors = file.iter().map(|(name, view)| {
            let (dtype, shape) = (view.dtype(), view.shape().to_vec());
            (name.to_owned(), Tensor { dtype, shape, bytes: view.data().to_vec() })
        });
        Ok(Self(tensors.collect()))
    }

    pub fn to_safetensors(
        &self, metadata: Option<HashMap<String, String>>,
    ) -> Result<Vec<u8>, safetensors::SafeTensorError> {
        let views = self.0.iter().map(|(name, tensor)| tensor.view().map(|view| (name, view)));
        safetensors::serialize(views.collect::<Result<Vec<_>, _>>()?, metadata)
    }

    /// Name, type and shape of every tensor, by name.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (&str, Dtype, &[usize])> {
        self.0.iter().map(|(name, tensor)| (name.as_str(), tensor.dtype, tensor.shape.as_slice()))
    }

    pub fn put<T: Element>(&mut self, name: &str, shape: &[usize], values: &[T]) {
        let tensor = Tensor { dtype: T::DTYPE, shape: shape.to_vec(), bytes: T::to_bytes(values) };
        self.0.insert(name.to_owned(), tensor);
    }

    pub fn get<T: Element>(&self, name: &str, shape: &[usize]) -> Result<Vec<T>, TensorError> {
        let tensor = self.tensor(name)?;
        if tensor.dtype != T::DTYPE || tensor.shape != shape {
            return Err(tensor.unexpected(name, format!("{:?} {shape:?}", T::DTYPE)));
        }
        Ok(T::from_bytes(&tensor.bytes))
    }

    pub(crate) fn get_one<T: Element>(&self, name: &str) -> Result<T, TensorError> {
        self.get(name, &[1])?.into_iter().next().ok_or_else(|| TensorError::Missing(name.to_owned()))
    }

    pub(crate) fn shape(&self, name: &str) -> Result<&[usize], TensorError> {
        Ok(&self.tensor(name)?.shape)
    }

    fn tensor(&self, name: &str) -> Result<&Tensor, TensorError> {
        self.0.get(name).ok_or_else(|| TensorError::Missing(name.to_owned()))
    }

    /// Adds a network as `{prefix}0.weight` [out, in], `{prefix}0.bias`, `{prefix}2.weight`, …: as `torch.nn.Sequential` does.
    pub(crate) fn put_network(&mut self, prefix: &str, network: &Mlp<f32>) {
        for (index, sizes) in network.sizes().windows(2).enumerate() {
            let (weight, bias) = torch_layer(network, index);
            self.put(&format!("{prefix}{}.weight", 2 * index), &[sizes[1], sizes[0]], &weight);
            self.put(&format!("{prefix}{}.bias", 2 * index), &[sizes[1]], bias);
        }
    }

    /// Fills a network from the tensors of [`Self::put_network`].
    pub fn get_network(&self, prefix: &str, network: &mut Mlp<f32>) -> Result<(), TensorError> {
        read_network(prefix, network, |name, shape| self.get(name, shape))
    }

    /// The same with a Sequential's names and in F32, where another program's file leaves one way to read it: layers named by
    /// numbers, `q_net.0.weight` or `layer1.weight`. Those behind a dot are places, of which an activation takes one too.
    fn as_sequential(&self) -> Option<Self> {
        let mut chains: BTreeMap<&str, BTreeMap<usize, &str>> = BTreeMap::new();
        for name in self.0.keys() {
            let stem = name.strip_suffix(".weight").or_else(|| name.strip_suffix(".bias"))?;
            let prefix = stem.trim_end_matches(|c: char| c.is_ascii_digit());
            chains.entry(prefix).or_default().insert(stem[prefix.len()..].parse().ok()?, stem);
        }
        if chains.len() > 1 {
            chains.retain(|prefix, _| !prefix.contains("target"));
        }
        let (prefix, layers) = chains.pop_first().filter(|_| chains.is_empty())?;
        let step = if prefix.is_empty() || prefix.ends_with('.') { 2 } else { 1 };
        let numbers: Vec<usize> = layers.keys().copied().collect();
        let mut renamed = Self::default();
        for (index, stem) in layers.values().enumerate() {
            for kind in ["weight", "bias"] {
                let tensor = self.0.get(&format!("{stem}.{kind}"))?.in_f32();
                renamed.0.insert(format!("{}.{kind}", 2 * index), tensor);
            }
        }
        numbers.windows(2).all(|pair| pair[0].checked_add(step) == Some(pair[1])).then_some(renamed)
    }

    /// The policy: the network in the unprefixed tensors, whoever wrote them, for a task with these sizes.
    pub fn network(&self, inputs: usize, outputs: usize) -> Result<Mlp<f32>, TensorError> {
        match self.as_sequential() {
            Some(renamed) => renamed.sequential(inputs, outputs),
            None => self.sequential(inputs, outputs),
        }
    }

    fn sequential(&self, inputs: usize, outputs: usize) -> Result<Mlp<f32>, TensorError> {
        let mut sizes = Vec::new();
        for index in 0..MAX_LAYERS {
            let name = format!("{}.weight", 2 * index);
            let Some(tensor) = self.0.get(&name) else { break };
            let &[rows, columns] = tensor.shape.as_slice() else {
                return Err(tensor.unexpected(&name, "F32 [out, in]".into()));
            };
            let expected = *sizes.last().unwrap_or(&columns);
            if columns != expected || !(1..=MAX_UNITS).contains(&rows) || !(1..=MAX_UNITS).contains(&columns)
            {
                return Err(tensor.unexpected(&name, format!("F32 [1…{MAX_UNITS}, {expected}]")));
            }
            if sizes.is_empty() {
                sizes.push(columns);
            }
            sizes.push(rows);
        }
        let policy_tensors =
            self.0.keys().filter(|name| name.starts_with(|first: char| first.is_ascii_digit())).count();
        if sizes.is_empty() || policy_tensors != 2 * (sizes.len() - 1) {
            return Err(TensorError::NoPolicy);
        }
        if (sizes[0], sizes[sizes.len() - 1]) != (inputs, outputs) {
            return Err(TensorError::WrongNetwork { found: sizes, inputs, outputs });
        }
        let mut network = Mlp::zeros(sizes);
        self.get_network("", &mut network)?;
        let finite = |layer: &[f32]| layer.iter().all(|value| value.is_finite());
        match (0..network.num_layers()).find(|&layer| !finite(network.layer(layer))) {
            Some(layer) => Err(TensorError::NotFinite(format!("{}.weight` or `{0}.bias", 2 * layer))),
            None => Ok(network),
        }
    }

    /// Adds the place of a stream of random numbers, shape (4), U64.
    pub(crate) fn put_rng(&mut self, name: &str, rng: &Rng) {
        self.put(name, &[4], &rng.to_words());
    }

    /// A stream of random numbers at the place of [`Self::put_rng`].
    pub(crate) fn get_rng(&self, name: &str) -> Result<Rng, TensorError> {
        let words = self.get::<u64>(name, &[4])?.try_into().ok().and_then(Rng::from_words);
        words.ok_or(TensorError::Inconsistent("generator of random numbers"))
    }
}

/// What a file is that begins so and is of another format, and how its weights get into a safetensors file.
pub(crate) fn foreign_format(start: &[u8]) -> Option<String> {
    const TORCH: &str =
        "from safetensors.torch import save_file; save_file(q_network.state_dict(), \"policy.safetensors\")";
    const KERAS: &str = "from safetensors.numpy import save_file; save_file({f\"{2 * i}.{n}\": w.T.copy() for i, layer in \
                         enumerate(l for l in model.layers if l.get_weights()) for n, w in zip((\"weight\", \"bias\"), \
                         layer.get_weights())}, \"policy.safetensors\")";
    let (kind, save) = match start {
        [b'P', b'K', 3, 4, ..] => {
            ("a zip archive, as torch.save, Stable-Baselines3 and Keras write them", TORCH)
        }
        [0x80, 2..=5, ..] => ("a pickle, as Python and old versions of torch.save write them", TORCH),
        [0x89, b'H', b'D', b'F', ..] => ("an HDF5 file, as Keras writes them", KERAS),
        [0x93, b'N', b'U', b'M', b'P', b'Y', ..] => ("an array of NumPy", TORCH),
        [8, _, 0x12, ..] => ("an ONNX file", TORCH),
        _ => return None,
    };
    let keras = if start.starts_with(b"PK") { ", or of a Keras model as in docs/interop.md" } else { "" };
    Some(format!("is {kind}, and no safetensors file. Save the weights as one, in Python: {save}{keras}"))
}

/// SHA-256 in lower-case hexadecimal.
pub fn sha256<T: AsRef<[u8]>>(parts: impl IntoIterator<Item = T>) -> String {
    use sha2::Digest as _;
    let mut hash = sha2::Sha256::new();
    parts.into_iter().for_each(|part| hash.update(part));
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A layer's weight as [out, in] and its bias.
fn torch_layer(network: &Mlp<f32>, layer: usize) -> (Vec<f32>, &[f32]) {
    let (inputs, outputs) = (network.sizes()[layer], network.sizes()[layer + 1]);
    let (weight, bias) = network.layer(layer).split_at(inputs * outputs);
    let torch_weight = (0..weight.len()).map(|i| weight[i % inputs * outputs + i / inputs]);
    (torch_weight.collect(), bias)
}

/// Fills a network from `{prefix}0.weight` [out, in], `{prefix}0.bias`, `{prefix}2.weight`, …, which `read` gives.
pub(crate) fn read_network<T: Kernels, E>(
    prefix: &str, network: &mut Mlp<T>, mut read: impl FnMut(&str, &[usize]) -> Result<Vec<T>, E>,
) -> Result<(), E> {
    for layer in 0..network.num_layers() {
        let (inputs, outputs) = (network.sizes()[layer], network.sizes()[layer + 1]);
        let torch_weight = read(&format!("{prefix}{}.weight", 2 * layer), &[outputs, inputs])?;
        let torch_bias = read(&format!("{prefix}{}.bias", 2 * layer), &[outputs])?;
        let (weight, bias) = network.layer_mut(layer).split_at_mut(inputs * outputs);
        for (position, value) in weight.iter_mut().enumerate() {
            *value = torch_weight[position % outputs * inputs + position / outputs];
        }
        bias.copy_from_slice(&torch_bias);
    }
    Ok(())
}

impl Tensor {
    /// The same with F64 rounded to F32.
    fn in_f32(&self) -> Self {
        if self.dtype != Dtype::F64 {
            return self.clone();
        }
        let values: Vec<f32> = f64::from_bytes(&self.bytes).into_iter().map(|value| value as f32).collect();
        Self { dtype: Dtype::F32, shape: self.shape.clone(), bytes: f32::to_bytes(&values) }
    }

    fn view(&self) -> Result<TensorView<'_>, safetensors::SafeTensorError> {
        TensorView::new(self.dtype, self.shape.clone(), &self.bytes)
    }

    fn unexpected(&self, name: &str, expected: String) -> TensorError {
        let (name, shape) = (name.to_owned(), self.shape.clone());
        TensorError::Unexpected { name, dtype: self.dtype, shape, expected }
    }
}

/// SHA-256 over a network's parameters as little-endian f32 in the order `0.weight` [out, in], `0.bias`, `2.weight`, ….
pub fn weights_sha256(network: &Mlp<f32>) -> String {
    sha256((0..network.num_layers()).flat_map(|layer| {
        let (weight, bias) = torch_layer(network, layer);
        [f32::to_bytes(&weight), f32::to_bytes(bias)]
    }))
}

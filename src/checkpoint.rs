//! Checkpoints: `.safetensors` files that PyTorch and NumPy users load as they are. docs/checkpoint.md describes
//! the layout.

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::path::{Path, PathBuf};

use safetensors::{Dtype, SafeTensors, View};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::nn::Mlp;

/// The version of the layout that this program writes.
pub const FORMAT_VERSION: u32 = 1;
/// The one key of the metadata, so that its bytes cannot depend on an order of keys; the value is JSON.
const METADATA_KEY: &str = "cartpole-dqn";
/// Largest file that is read, in bytes.
const MAX_FILE_SIZE: u64 = 1 << 32;
/// Most layers and most units of a layer that a policy may have.
const MAX_LAYERS: usize = 64;
const MAX_UNITS: usize = 1 << 16;

/// A checkpoint in memory: named tensors, and the header if this program wrote it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checkpoint {
    tensors: BTreeMap<String, Tensor>,
    metadata: Option<String>,
}

#[derive(Clone, Debug, PartialEq)]
struct Tensor {
    dtype: Dtype,
    shape: Vec<usize>,
    /// Little-endian.
    bytes: Vec<u8>,
}

/// What is wrong with a checkpoint.
#[derive(Debug, thiserror::Error)]
#[error("checkpoint {}: {problem}", path.display())]
pub struct CheckpointError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub problem: Problem,
}

/// See [`CheckpointError`].
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum Problem {
    #[error("cannot be read: {0}")]
    Unreadable(io::Error),
    #[error("has {0} bytes; at most {MAX_FILE_SIZE} are allowed")]
    TooLarge(u64),
    #[error("is not a safetensors file, or is cut off or damaged ({0})")]
    NotSafetensors(String),
    #[error("has no tensor `{0}`")]
    Missing(String),
    #[error("tensor `{name}` is {dtype:?} {shape:?}, expected {expected}")]
    WrongTensor { name: String, dtype: Dtype, shape: Vec<usize>, expected: String },
    #[error(
        "holds no policy: the tensors without a prefix must be exactly `0.weight`, `0.bias`, `2.weight`, …"
    )]
    NoPolicy,
    #[error("its policy has layers {found:?}; the task needs {inputs} inputs and {outputs} outputs")]
    WrongNetwork { found: Vec<usize>, inputs: usize, outputs: usize },
    #[error("tensor `{0}` holds NaN or infinity")]
    NotFinite(String),
    #[error("has no metadata of cartpole-dqn: another program wrote it")]
    NoHeader,
    #[error("has format version {0}; this program reads version {FORMAT_VERSION}")]
    WrongVersion(u64),
    #[error("its metadata is damaged: {0}")]
    BadHeader(String),
    #[error("holds a policy but not the state of a run; `last.safetensors` does")]
    NotResumable,
    #[error("its replay memory does not fit together")]
    Replay,
}

/// A number that tensors consist of.
pub trait Element: Copy {
    /// Its type in the file.
    const DTYPE: Dtype;
    /// Little-endian bytes.
    fn to_bytes(values: &[Self]) -> Vec<u8>;
    /// The inverse of [`Self::to_bytes`].
    fn from_bytes(bytes: &[u8]) -> Vec<Self>;
}

impl Element for f32 {
    const DTYPE: Dtype = Dtype::F32;
    fn to_bytes(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    }
    fn from_bytes(bytes: &[u8]) -> Vec<f32> {
        bytes.as_chunks::<4>().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect()
    }
}

impl Element for u8 {
    const DTYPE: Dtype = Dtype::U8;
    fn to_bytes(values: &[u8]) -> Vec<u8> {
        values.to_vec()
    }
    fn from_bytes(bytes: &[u8]) -> Vec<u8> {
        bytes.to_vec()
    }
}

impl View for &Tensor {
    fn dtype(&self) -> Dtype {
        self.dtype
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> std::borrow::Cow<'_, [u8]> {
        (&self.bytes).into()
    }
    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

impl Checkpoint {
    /// A checkpoint with a header, whose `format_version` is [`FORMAT_VERSION`], and no tensors yet.
    ///
    /// # Errors
    /// When JSON cannot express the header.
    pub fn new(header: &impl Serialize) -> io::Result<Self> {
        Ok(Self { tensors: BTreeMap::new(), metadata: Some(serde_json::to_string(header)?) })
    }

    /// Reads a file whole.
    ///
    /// # Errors
    /// When it cannot be read, is too large, or is not a whole safetensors file.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        Self::read_bytes(path)
            .and_then(|bytes| Self::from_bytes(&bytes))
            .map_err(|problem| CheckpointError { path: path.to_owned(), problem })
    }

    fn read_bytes(path: &Path) -> Result<Vec<u8>, Problem> {
        let found = std::fs::metadata(path).map_err(Problem::Unreadable)?;
        if !found.is_file() {
            return Err(Problem::Unreadable(io::Error::new(io::ErrorKind::InvalidInput, "not a file")));
        }
        if found.len() > MAX_FILE_SIZE {
            return Err(Problem::TooLarge(found.len()));
        }
        std::fs::read(path).map_err(Problem::Unreadable)
    }

    /// Parses the content of a file.
    ///
    /// # Errors
    /// When it is not a whole safetensors file.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Problem> {
        let damaged = |error: safetensors::SafeTensorError| Problem::NotSafetensors(error.to_string());
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
        let file = SafeTensors::deserialize(bytes).map_err(damaged)?;
        let tensors = file.iter().map(|(name, view)| {
            let tensor =
                Tensor { dtype: view.dtype(), shape: view.shape().to_vec(), bytes: view.data().to_vec() };
            (name.to_owned(), tensor)
        });
        let header = metadata.metadata().as_ref().and_then(|metadata| metadata.get(METADATA_KEY).cloned());
        Ok(Self { tensors: tensors.collect(), metadata: header })
    }

    /// The content of a file; equal checkpoints give equal bytes.
    ///
    /// # Errors
    /// When the format cannot express it.
    pub fn to_bytes(&self) -> io::Result<Vec<u8>> {
        let metadata = self.metadata.clone().map(|header| HashMap::from([(METADATA_KEY.to_owned(), header)]));
        safetensors::serialize(&self.tensors, metadata).map_err(io::Error::other)
    }

    /// Writes a file whole.
    ///
    /// # Errors
    /// When it cannot be written; a file that was there before then still is.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        let bytes = self.to_bytes()?;
        crate::files::write_whole(path, |file| file.write_all(&bytes))
    }

    /// The header.
    ///
    /// # Errors
    /// When there is none, or it is of another version or damaged.
    pub fn header<H: DeserializeOwned>(&self) -> Result<H, Problem> {
        let text = self.metadata.as_deref().ok_or(Problem::NoHeader)?;
        self.check_version()?;
        serde_json::from_str(text).map_err(|error| Problem::BadHeader(error.to_string()))
    }

    /// Makes sure that this program knows the format, if there is a header that names one.
    fn check_version(&self) -> Result<(), Problem> {
        #[derive(Deserialize)]
        struct Version {
            format_version: u64,
        }
        let Some(text) = self.metadata.as_deref() else { return Ok(()) };
        match serde_json::from_str(text) {
            Ok(Version { format_version }) if format_version == u64::from(FORMAT_VERSION) => Ok(()),
            Ok(Version { format_version }) => Err(Problem::WrongVersion(format_version)),
            Err(error) => Err(Problem::BadHeader(error.to_string())),
        }
    }

    /// Name, type and shape of every tensor, by name.
    pub fn tensors(&self) -> impl Iterator<Item = (&str, Dtype, &[usize])> {
        self.tensors.iter().map(|(name, tensor)| (name.as_str(), tensor.dtype, tensor.shape.as_slice()))
    }

    /// Adds a tensor.
    pub fn put<T: Element>(&mut self, name: &str, shape: &[usize], values: &[T]) {
        let tensor = Tensor { dtype: T::DTYPE, shape: shape.to_vec(), bytes: T::to_bytes(values) };
        self.tensors.insert(name.to_owned(), tensor);
    }

    /// A tensor's values.
    ///
    /// # Errors
    /// When it is missing or of another type or shape.
    pub fn get<T: Element>(&self, name: &str, shape: &[usize]) -> Result<Vec<T>, Problem> {
        let tensor = self.tensor(name)?;
        if tensor.dtype != T::DTYPE || tensor.shape != shape {
            return Err(tensor.unexpected(name, format!("{:?} {shape:?}", T::DTYPE)));
        }
        Ok(T::from_bytes(&tensor.bytes))
    }

    /// A tensor's shape.
    ///
    /// # Errors
    /// When it is missing.
    pub fn shape(&self, name: &str) -> Result<&[usize], Problem> {
        Ok(&self.tensor(name)?.shape)
    }

    fn tensor(&self, name: &str) -> Result<&Tensor, Problem> {
        self.tensors.get(name).ok_or_else(|| Problem::Missing(name.to_owned()))
    }

    /// Adds a network as `{prefix}0.weight` [out, in], `{prefix}0.bias`, `{prefix}2.weight`, …: the names that a
    /// `torch.nn.Sequential` of Linear and ReLU gives them.
    pub fn put_network(&mut self, prefix: &str, network: &Mlp<f32>) {
        for (index, sizes) in network.sizes().windows(2).enumerate() {
            let (weight, bias) = torch_layer(network, index);
            self.put(&format!("{prefix}{}.weight", 2 * index), &[sizes[1], sizes[0]], &weight);
            self.put(&format!("{prefix}{}.bias", 2 * index), &[sizes[1]], bias);
        }
    }

    /// Fills a network from the tensors of [`Self::put_network`].
    ///
    /// # Errors
    /// When one is missing or of another type or shape.
    pub fn get_network(&self, prefix: &str, network: &mut Mlp<f32>) -> Result<(), Problem> {
        for (index, sizes) in network.sizes().to_vec().windows(2).enumerate() {
            let (inputs, outputs) = (sizes[0], sizes[1]);
            let name = |kind| format!("{prefix}{}.{kind}", 2 * index);
            let torch_weight = self.get::<f32>(&name("weight"), &[outputs, inputs])?;
            let (weight, bias) = network.layer_mut(index).split_at_mut(inputs * outputs);
            for (position, value) in weight.iter_mut().enumerate() {
                *value = torch_weight[position % outputs * inputs + position / outputs];
            }
            bias.copy_from_slice(&self.get::<f32>(&name("bias"), &[outputs])?);
        }
        Ok(())
    }

    /// The policy: the network in the unprefixed tensors, whoever wrote them, for a task with these sizes.
    ///
    /// # Errors
    /// When there is none, it is of another shape, a weight is not finite, or a header names another version.
    pub fn policy(&self, inputs: usize, outputs: usize) -> Result<Mlp<f32>, Problem> {
        self.check_version()?;
        let mut sizes = Vec::new();
        for index in 0..MAX_LAYERS {
            let name = format!("{}.weight", 2 * index);
            let Some(tensor) = self.tensors.get(&name) else { break };
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
            self.tensors.keys().filter(|name| name.starts_with(|first: char| first.is_ascii_digit())).count();
        if sizes.is_empty() || policy_tensors != 2 * (sizes.len() - 1) {
            return Err(Problem::NoPolicy);
        }
        if (sizes[0], sizes[sizes.len() - 1]) != (inputs, outputs) {
            return Err(Problem::WrongNetwork { found: sizes, inputs, outputs });
        }
        let mut network = Mlp::zeros(sizes);
        self.get_network("", &mut network)?;
        let finite = |layer: &[f32]| layer.iter().all(|value| value.is_finite());
        match (0..network.num_layers()).find(|&layer| !finite(network.layer(layer))) {
            Some(layer) => Err(Problem::NotFinite(format!("{}.weight` or `{0}.bias", 2 * layer))),
            None => Ok(network),
        }
    }
}

/// A layer's weight as [out, in] and its bias.
fn torch_layer(network: &Mlp<f32>, layer: usize) -> (Vec<f32>, &[f32]) {
    let (inputs, outputs) = (network.sizes()[layer], network.sizes()[layer + 1]);
    let (weight, bias) = network.layer(layer).split_at(inputs * outputs);
    let torch_weight =
        (0..weight.len()).map(|position| weight[position % inputs * outputs + position / inputs]);
    (torch_weight.collect(), bias)
}

impl Tensor {
    fn unexpected(&self, name: &str, expected: String) -> Problem {
        Problem::WrongTensor { name: name.to_owned(), dtype: self.dtype, shape: self.shape.clone(), expected }
    }
}

/// SHA-256 over a network's parameters as little-endian f32 in the order `0.weight` [out, in], `0.bias`,
/// `2.weight`, ….
pub fn weights_sha256(network: &Mlp<f32>) -> String {
    use sha2::Digest as _;
    let mut hash = sha2::Sha256::new();
    for layer in 0..network.num_layers() {
        let (weight, bias) = torch_layer(network, layer);
        hash.update(f32::to_bytes(&weight));
        hash.update(f32::to_bytes(bias));
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

//! Checkpoints: `.safetensors` files that PyTorch and NumPy users load as they are. docs/checkpoint.md describes
//! the layout.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};

use safetensors::tensor::Metadata;
use safetensors::{Dtype, SafeTensors, View};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::files::{check_memory, open_ordinary, read_limited, write_whole_keeping};
use crate::nn::Mlp;

/// The version of the layout, the only one that this program reads. It is raised whenever an old reader would misread a
/// new file.
pub const FORMAT_VERSION: u32 = 3;
/// The one key of the metadata, so that its bytes cannot depend on an order of keys; the value is JSON.
const METADATA_KEY: &str = "cartpole-dqn";
/// What stands before the place of a file's own SHA-256 as this program writes it.
const SEAL: &[u8] = br#"\"sha256\":\""#;
/// How a header begins.
const START: &str = "{\"format_version\":";
/// What stands in the place of the SHA-256 while that is computed.
const NO_SHA256: &str = "0000000000000000000000000000000000000000000000000000000000000000";
/// Largest file that is read, in bytes.
const MAX_FILE_SIZE: u64 = 1 << 32;
/// Longest JSON header, as the crate `safetensors` has it.
const MAX_HEADER_SIZE: u64 = 100_000_000;
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

/// The header as it is written.
#[derive(Serialize)]
struct Sealed<'a, H> {
    format_version: u32,
    sha256: &'a str,
    #[serde(flatten)]
    header: &'a H,
}

/// What must be read first of a header.
#[derive(Deserialize)]
struct Found {
    format_version: u32,
    sha256: Option<String>,
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
    #[error("is not a safetensors file, or is cut off or damaged ({0})")]
    NotSafetensors(String),
    #[error("is damaged: its content does not match the SHA-256 in it")]
    WrongSha256,
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
    #[error("has no metadata of cartpole-dqn, so another program wrote it")]
    NoHeader,
    #[error("has format version {0}; this program reads version {FORMAT_VERSION}")]
    WrongVersion(u32),
    #[error("its metadata is damaged: {0}")]
    BadHeader(String),
    #[error("holds only a policy and cannot be resumed; `last.safetensors` holds the state of a run")]
    NotResumable,
    #[error("its replay memory is inconsistent")]
    Replay,
    #[error("its counters are inconsistent, or belong to another task")]
    State,
    #[error("needs more memory than there is: {0}")]
    Memory(String),
    #[error("does not belong to the config.json of its run: {0}")]
    OtherRun(String),
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
    /// A checkpoint with a header and no tensors yet.
    ///
    /// # Errors
    /// When JSON cannot express the header.
    pub fn new(header: &impl Serialize) -> io::Result<Self> {
        let sealed = Sealed { format_version: FORMAT_VERSION, sha256: NO_SHA256, header };
        Ok(Self { tensors: BTreeMap::new(), metadata: Some(serde_json::to_string(&sealed)?) })
    }

    /// Reads a file whole. A file that cannot be one is refused by its size and its header: of what follows them nothing
    /// is read.
    ///
    /// # Errors
    /// When it cannot be read, is too large, or is not a whole safetensors file.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        let read = || {
            check_header(path)?;
            let bytes = read_limited(path, MAX_FILE_SIZE).map_err(Problem::Unreadable)?;
            // The tensors here, and where they are put.
            check_memory([bytes.len() as u64; 2]).map_err(Problem::Unreadable)?;
            Self::from_bytes(&bytes)
        };
        read().map_err(|problem| CheckpointError { path: path.to_owned(), problem })
    }

    /// Reads a stream whole.
    ///
    /// # Errors
    /// As [`Self::read`]. What does not begin as a safetensors file does is not read any further.
    pub fn read_from(mut stream: impl Read) -> Result<Self, Problem> {
        let mut bytes = Vec::new();
        // The length of the header in 8 bytes, then the header, which is a JSON object.
        stream.by_ref().take(9).read_to_end(&mut bytes).map_err(Problem::Unreadable)?;
        if bytes.last() == Some(&b'{') {
            stream.take(MAX_FILE_SIZE).read_to_end(&mut bytes).map_err(Problem::Unreadable)?;
        }
        if bytes.len() as u64 > MAX_FILE_SIZE {
            let message = format!("larger than {MAX_FILE_SIZE} bytes");
            return Err(Problem::Unreadable(io::Error::new(io::ErrorKind::FileTooLarge, message)));
        }
        Self::from_bytes(&bytes)
    }

    /// Parses the content of a file.
    ///
    /// # Errors
    /// When it is not a whole safetensors file, or not as it was written.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Problem> {
        let damaged = |error: safetensors::SafeTensorError| Problem::NotSafetensors(error.to_string());
        let (header_length, metadata) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
        let file = SafeTensors::deserialize(bytes).map_err(damaged)?;
        let tensors = file.iter().map(|(name, view)| {
            let tensor =
                Tensor { dtype: view.dtype(), shape: view.shape().to_vec(), bytes: view.data().to_vec() };
            (name.to_owned(), tensor)
        });
        let tensors = tensors.collect();
        let metadata = metadata.metadata().clone().unwrap_or_default();
        // Under another name it is a header of ours whose name is damaged.
        let header =
            metadata.into_iter().find(|(name, text)| name == METADATA_KEY || text.starts_with(START));
        match header {
            Some((name, text)) if name != METADATA_KEY || !is_sealed(bytes, header_length, &text) => {
                Err(Problem::WrongSha256)
            }
            header => Ok(Self { tensors, metadata: header.map(|(_, text)| text) }),
        }
    }

    /// The content of a file; equal checkpoints give equal bytes.
    ///
    /// # Errors
    /// When the format cannot express it.
    pub fn to_bytes(&self) -> io::Result<Vec<u8>> {
        let metadata = self.metadata.clone().map(|header| HashMap::from([(METADATA_KEY.to_owned(), header)]));
        let mut bytes = safetensors::serialize(&self.tensors, metadata).map_err(io::Error::other)?;
        seal(&mut bytes);
        Ok(bytes)
    }

    /// Writes a file whole.
    ///
    /// # Errors
    /// When it cannot be written; a file that was there before then still is.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        self.write_keeping(path, None)
    }

    /// As [`Self::write`], and the file that was there before stays under the name `kept`.
    ///
    /// # Errors
    /// See there.
    pub fn write_keeping(&self, path: &Path, kept: Option<&Path>) -> io::Result<()> {
        let bytes = self.to_bytes()?;
        write_whole_keeping(path, kept, |file| file.write_all(&bytes))
    }

    /// The header.
    ///
    /// # Errors
    /// When there is none, or it is of another version or damaged.
    pub fn header<H: DeserializeOwned>(&self) -> Result<H, Problem> {
        let text = self.metadata.as_deref().ok_or(Problem::NoHeader)?;
        self.version()?;
        serde_json::from_str(text).map_err(|error| Problem::BadHeader(error.to_string()))
    }

    /// The format's version; none if another program wrote the file.
    ///
    /// # Errors
    /// When this program does not know it, or the header does not say it.
    pub fn version(&self) -> Result<Option<u32>, Problem> {
        let Some(text) = self.metadata.as_deref() else { return Ok(None) };
        let found: Found =
            serde_json::from_str(text).map_err(|error| Problem::BadHeader(error.to_string()))?;
        match found.format_version {
            FORMAT_VERSION => Ok(Some(FORMAT_VERSION)),
            version => Err(Problem::WrongVersion(version)),
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
        self.version()?;
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

/// Checks the length of a file against what its header says.
fn check_header(path: &Path) -> Result<(), Problem> {
    const LENGTH: usize = size_of::<u64>();
    let damaged = |reason: &str| Problem::NotSafetensors(reason.into());
    let mut file = open_ordinary(File::options().read(true), path).map_err(Problem::Unreadable)?;
    let size = file.metadata().map_err(Problem::Unreadable)?.len();
    if size > MAX_FILE_SIZE {
        let message = format!("larger than {MAX_FILE_SIZE} bytes");
        return Err(Problem::Unreadable(io::Error::new(io::ErrorKind::FileTooLarge, message)));
    }
    let mut length = [0; LENGTH];
    file.read_exact(&mut length).map_err(|_| damaged("shorter than 8 bytes"))?;
    let length = u64::from_le_bytes(length);
    let data = size.checked_sub(LENGTH as u64).and_then(|rest| rest.checked_sub(length));
    let data = data.filter(|_| length <= MAX_HEADER_SIZE).ok_or_else(|| damaged("its header is too long"))?;
    let mut header = Vec::new();
    file.take(length).read_to_end(&mut header).map_err(Problem::Unreadable)?;
    let header: Metadata =
        serde_json::from_slice(&header).map_err(|error| damaged(&format!("its header: {error}")))?;
    match header.data_len() as u64 {
        expected if expected == data => Ok(()),
        expected => Err(damaged(&format!("{data} bytes of tensors, and its header says {expected}"))),
    }
}

/// Whether a file is as it was written, as far as its header says. Its SHA-256 is what stands first where its digits
/// do, whoever has sealed it and with which spaces.
fn is_sealed(bytes: &[u8], header_length: usize, header: &str) -> bool {
    let Ok(found) = serde_json::from_str::<Found>(header) else { return true };
    let Some(sha256) = found.sha256 else { return false };
    let header = &bytes[..bytes.len().min(size_of::<u64>() + header_length)];
    let place = header.windows(NO_SHA256.len()).position(|window| window == sha256.as_bytes());
    place.is_some_and(|start| sha256 == sha256_without(bytes, start..start + NO_SHA256.len()))
}

/// Writes the SHA-256 of a file into it, if its header has a place for it.
pub fn seal(bytes: &mut [u8]) {
    if let Some(place) = seal_place(bytes) {
        let sha256 = sha256_without(bytes, place.clone());
        bytes[place].copy_from_slice(sha256.as_bytes());
    }
}

fn seal_place(bytes: &[u8]) -> Option<Range<usize>> {
    let start = bytes.windows(SEAL.len()).position(|window| window == SEAL)? + SEAL.len();
    (start + NO_SHA256.len() <= bytes.len()).then_some(start..start + NO_SHA256.len())
}

/// The SHA-256 of a file in which that place holds zeros.
fn sha256_without(bytes: &[u8], place: Range<usize>) -> String {
    sha256([&bytes[..place.start], NO_SHA256.as_bytes(), &bytes[place.end..]])
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
    sha256((0..network.num_layers()).flat_map(|layer| {
        let (weight, bias) = torch_layer(network, layer);
        [f32::to_bytes(&weight), f32::to_bytes(bias)]
    }))
}

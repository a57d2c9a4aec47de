//! Checkpoints: `.safetensors` files that PyTorch and NumPy users load as they are. docs/checkpoint.md describes the layout.

use std::collections::HashMap;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::agent::Policy;
use crate::files::{Directory, check_size, open_ordinary, read_limited, read_rest};
use crate::tensors::{TensorError, Tensors, check_count, foreign_format, header_of, sha256};

/// The version of the layout that this program reads. Raised whenever an old reader would misread a new file.
pub const FORMAT_VERSION: u32 = 3;
/// The one key of the metadata, so that its bytes cannot depend on an order of keys; the value is JSON.
const METADATA_KEY: &str = "cartpole-dqn";
/// The bytes before a file's own SHA-256, as this program writes them.
const SEAL: &[u8] = br#"\"sha256\":\""#;
const START: &str = "{\"format_version\":";
/// Stands for the SHA-256 while that is computed.
const NO_SHA256: &str = "0000000000000000000000000000000000000000000000000000000000000000";
pub(super) const MAX_FILE_SIZE: u64 = 1 << 32;
/// Longest JSON header, as the crate `safetensors` has it.
const MAX_HEADER_SIZE: u64 = 100_000_000;

/// A checkpoint in memory: named tensors, and the header if this program wrote it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checkpoint {
    pub tensors: Tensors,
    metadata: Option<String>,
}

#[derive(Serialize)]
struct Sealed<'a, H> {
    format_version: u32,
    sha256: &'a str,
    #[serde(flatten)]
    header: &'a H,
}

/// The part of a header that is read first.
#[derive(Deserialize)]
struct Seal {
    format_version: u32,
    sha256: Option<String>,
}

#[derive(Debug, thiserror::Error)]
#[error("checkpoint {}: {problem}", path.display())]
pub struct CheckpointError {
    pub path: PathBuf,
    pub(crate) problem: CheckpointProblem,
}

#[derive(Debug, thiserror::Error)]
pub enum CheckpointProblem {
    #[error("cannot be read: {0}")]
    Unreadable(#[from] io::Error),
    #[error("is not a safetensors file, or is cut off or damaged ({0})")]
    NotSafetensors(String),
    #[error("{0}")]
    Foreign(String),
    #[error("is damaged: its content does not match the SHA-256 in it")]
    WrongSha256,
    #[error(transparent)]
    Tensor(#[from] TensorError),
    #[error("has no metadata of cartpole-dqn, so another program wrote it")]
    NoHeader,
    #[error("has format version {0}; this program reads version {FORMAT_VERSION}")]
    WrongVersion(u32),
    #[error("its metadata is damaged: {0}")]
    BadHeader(#[from] serde_json::Error),
    #[error("holds only a policy and cannot be resumed; `last.safetensors` holds the state of a run")]
    NotResumable,
    #[error(transparent)]
    Resume(#[from] crate::trainer::ResumeError),
    #[error("needs more memory than there is: {0}")]
    Memory(String),
    #[error("does not belong to the config.json of its run: {0}")]
    OtherRun(String),
}

impl Checkpoint {
    pub fn new(header: &impl Serialize) -> io::Result<Self> {
        let sealed = Sealed { format_version: FORMAT_VERSION, sha256: NO_SHA256, header };
        Ok(Self { tensors: Tensors::default(), metadata: Some(serde_json::to_string(&sealed)?) })
    }

    /// Reads a file whole. One that cannot be a checkpoint is refused by its size and header, and not read any further.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        Self::read_unnamed(path).map_err(|problem| CheckpointError { path: path.to_owned(), problem })
    }

    /// Parses the file of a run: as [`Self::read`], without the name of the file in the error.
    pub(super) fn read_unnamed(path: &Path) -> Result<Self, CheckpointProblem> {
        check_header(path)?;
        let bytes = read_limited(path, MAX_FILE_SIZE)?;
        // The tensors here, and where they are put.
        crate::memory::check_memory([bytes.len() as u64; 2])?;
        Self::from_bytes(&bytes)
    }

    /// Reads a stream whole. What does not begin as a safetensors file does is not read any further.
    pub(crate) fn read_from(mut stream: impl Read) -> Result<Self, CheckpointProblem> {
        let mut bytes = Vec::new();
        // The length of the header in 8 bytes, then the header, which is a JSON object.
        stream.by_ref().take(9).read_to_end(&mut bytes)?;
        if bytes.last() == Some(&b'{') {
            read_rest(stream, &mut bytes, MAX_FILE_SIZE)?;
        }
        Self::from_bytes(&bytes)
    }

    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointProblem> {
        let damaged = |error: safetensors::SafeTensorError| no_safetensors(bytes, error.to_string());
        check_count(header_of(bytes)).map_err(CheckpointProblem::NotSafetensors)?;
        let (header_length, metadata) = safetensors::SafeTensors::read_metadata(bytes).map_err(damaged)?;
        let tensors = Tensors::from_safetensors(bytes).map_err(damaged)?;
        let metadata = metadata.metadata().clone().unwrap_or_default();
        // Under another name it is a header of ours whose name is damaged.
        let header = metadata.into_iter().find(|(key, text)| key == METADATA_KEY || text.starts_with(START));
        match header {
            Some((name, text)) if name != METADATA_KEY || !is_sealed(bytes, header_length, &text) => {
                Err(CheckpointProblem::WrongSha256)
            }
            header => Ok(Self { tensors, metadata: header.map(|(_, text)| text) }),
        }
    }

    /// The content of a file; equal checkpoints give equal bytes.
    pub fn to_bytes(&self) -> io::Result<Vec<u8>> {
        let metadata = self.metadata.clone().map(|header| HashMap::from([(METADATA_KEY.to_owned(), header)]));
        let mut bytes = self.tensors.to_safetensors(metadata).map_err(io::Error::other)?;
        seal(&mut bytes);
        Ok(bytes)
    }

    /// Writes a file whole, below a directory and through no link. The file from before stays under the name `kept`.
    pub(crate) fn write_in(&self, directory: &Directory, path: &Path, kept: Option<&Path>) -> io::Result<()> {
        let bytes = self.to_bytes()?;
        directory.write_whole(path, kept, |file| file.write_all(&bytes))
    }

    pub fn header<H: DeserializeOwned>(&self) -> Result<H, CheckpointProblem> {
        let text = self.metadata.as_deref().ok_or(CheckpointProblem::NoHeader)?;
        self.version()?;
        Ok(serde_json::from_str(text)?)
    }

    /// The format's version; none if another program wrote the file.
    pub fn version(&self) -> Result<Option<u32>, CheckpointProblem> {
        let Some(text) = self.metadata.as_deref() else { return Ok(None) };
        let found: Seal = serde_json::from_str(text)?;
        match found.format_version {
            FORMAT_VERSION => Ok(Some(FORMAT_VERSION)),
            version => Err(CheckpointProblem::WrongVersion(version)),
        }
    }

    /// The policy: the network in the tensors without a prefix, whoever wrote them, for a task.
    pub fn policy(&self, spec: &crate::env::Spec) -> Result<Policy, CheckpointProblem> {
        self.version()?;
        Ok(Policy::from_tensors(&self.tensors, spec.observation_size, spec.num_actions)?)
    }
}

/// The problem of bytes that are no whole safetensors file, and begin like this.
fn no_safetensors(start: &[u8], reason: String) -> CheckpointProblem {
    foreign_format(start).map_or(CheckpointProblem::NotSafetensors(reason), CheckpointProblem::Foreign)
}

/// Checks the length of a file against what its header says.
fn check_header(path: &Path) -> Result<(), CheckpointProblem> {
    const LENGTH: usize = size_of::<u64>();
    let mut file = open_ordinary(path)?;
    let size = file.metadata()?.len();
    check_size(size, MAX_FILE_SIZE)?;
    let mut length = [0; LENGTH];
    file.read_exact(&mut length)
        .map_err(|_| CheckpointProblem::NotSafetensors("shorter than 8 bytes".into()))?;
    let damaged = |reason: &str| no_safetensors(&length, reason.into());
    let length = u64::from_le_bytes(length);
    let data = size.checked_sub(LENGTH as u64).and_then(|rest| rest.checked_sub(length));
    let data = data.filter(|_| length <= MAX_HEADER_SIZE).ok_or_else(|| damaged("its header is too long"))?;
    let mut header = Vec::new();
    file.take(length).read_to_end(&mut header)?;
    check_count(&header).map_err(|problem| damaged(&problem))?;
    let header: safetensors::tensor::Metadata =
        serde_json::from_slice(&header).map_err(|error| damaged(&format!("its header: {error}")))?;
    match header.data_len() as u64 {
        expected if expected == data => Ok(()),
        expected => Err(damaged(&format!("{data} bytes of tensors, and its header says {expected}"))),
    }
}

/// Whether a file is as it was written. Its SHA-256 is where its digits first occur in the header: others may put more spaces.
fn is_sealed(bytes: &[u8], header_length: usize, header: &str) -> bool {
    let Ok(found) = serde_json::from_str::<Seal>(header) else { return true };
    let Some(sha256) = found.sha256 else { return false };
    let header = &bytes[..bytes.len().min(size_of::<u64>() + header_length)];
    let place = header.windows(NO_SHA256.len()).position(|window| window == sha256.as_bytes());
    place.is_some_and(|start| sha256 == sha256_without(bytes, start..start + NO_SHA256.len()))
}

/// Writes the SHA-256 of a file into it, if its header has a place for it.
pub fn seal(bytes: &mut [u8]) {
    let Some(start) = bytes.windows(SEAL.len()).position(|window| window == SEAL) else { return };
    let place = start + SEAL.len()..start + SEAL.len() + NO_SHA256.len();
    if place.end <= bytes.len() {
        let sha256 = sha256_without(bytes, place.clone());
        bytes[place].copy_from_slice(sha256.as_bytes());
    }
}

/// The SHA-256 of a file in which that place holds zeros.
fn sha256_without(bytes: &[u8], place: std::ops::Range<usize>) -> String {
    sha256([&bytes[..place.start], NO_SHA256.as_bytes(), &bytes[place.end..]])
}

"""Reading and writing of safetensors files (https://github.com/huggingface/safetensors)."""

from __future__ import annotations

import hashlib
import json
import math
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ._run import PathLike, checkpoint_of, shown

MAX_FILE_SIZE = 1 << 32  # bytes
MAX_HEADER_SIZE = 100_000_000  # bytes
MAX_TENSORS = 4096
METADATA_KEY = "cartpole-dqn"
METADATA_START = '{"format_version":'

# The types by their names in the header. NumPy has no BF16: it is read as its upper half of an F32.
DTYPES = {
    "F64": "<f8", "F32": "<f4", "F16": "<f2", "BF16": "<u2", "I64": "<i8", "I32": "<i4", "I16": "<i2", "I8": "<i1",
    "U64": "<u8", "U32": "<u4", "U16": "<u2", "U8": "<u1", "BOOL": "<b1",
}  # fmt: skip
NAMES = {np.dtype(dtype): name for name, dtype in DTYPES.items() if name != "BF16"}

FOREIGN = {
    b"PK\x03\x04": "a zip archive, as torch.save, Stable-Baselines3 and Keras write them",
    b"\x80": "a pickle, as Python and old versions of torch.save write them",
    b"\x89HDF": "an HDF5 file, as Keras writes them",
    b"\x93NUMPY": "an array of NumPy",
}


def tensors(path: PathLike) -> dict[str, np.ndarray]:
    """The tensors of a checkpoint or any other safetensors file, by name.

    docs/checkpoint.md of the project describes those of a checkpoint: `0.weight` [out, in], `0.bias` [out], `2.weight`, … are
    the policy; `last.safetensors` also holds `online.…`, `target.…`, `replay.…` and the state of Adam.

    Args:
        path: a file, or the directory of a run, whose best policy is read.

    Returns arrays with the shapes and types of the file. BF16 becomes float32, which is exact.

    Raises ValueError if the file is not a whole safetensors file, or does not match the SHA-256 in it, and OSError if it
    cannot be read.
    """
    return read(checkpoint_of(path))[0]


def read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The tensors of a file, and its metadata."""
    with open(path, "rb") as file:
        start = file.read(8)
        try:
            header_bytes, data_size = _header(file, start)
            header = _parse(header_bytes)
            metadata = _metadata(header)
            _check_layout(header, data_size)
        except ValueError as error:
            kind = next((kind for magic, kind in FOREIGN.items() if start.startswith(magic)), None)
            if kind:
                raise ValueError(
                    f"{path} is {kind}, and no safetensors file. Save the weights as one: from safetensors.torch import save_file; "
                    'save_file(q_network.state_dict(), "policy.safetensors")'
                ) from None
            raise ValueError(f"{path} is not a safetensors file, or is cut off or damaged: {error}") from None
        data = bytearray(file.read(data_size))
    if len(data) != data_size:
        raise ValueError(f"{path} has become shorter while it was read: read it again")
    _check_sha256(path, start + header_bytes, data, metadata)
    return {name: _array(entry, data) for name, entry in header.items()}, metadata


def _header(file: BinaryIO, start: bytes) -> tuple[bytes, int]:
    """The header's bytes, and the number of bytes behind it."""
    size = os.fstat(file.fileno()).st_size
    if size > MAX_FILE_SIZE:
        raise ValueError(f"it is larger than {MAX_FILE_SIZE} bytes")
    if len(start) < 8:
        raise ValueError("it is shorter than 8 bytes")
    (length,) = struct.unpack("<Q", start)
    if length > min(size - 8, MAX_HEADER_SIZE):
        raise ValueError("its header is too long")
    return file.read(length), size - 8 - length


def _parse(header: bytes) -> dict[str, Any]:
    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            raise ValueError("a name stands twice in its header")
        return found

    if header.count(b'"data_offsets"') > MAX_TENSORS:
        raise ValueError(f"it has more than {MAX_TENSORS} tensors")
    try:
        parsed = json.loads(header.decode(), object_pairs_hook=unique)
    except RecursionError:
        raise ValueError("its header is nested too deeply") from None
    if not isinstance(parsed, dict):
        raise ValueError("its header is no JSON object")
    return parsed


def _metadata(header: dict[str, Any]) -> dict[str, str]:
    """Takes the metadata out of the header."""
    metadata = header.pop("__metadata__", None)
    if metadata is None:
        return {}
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        raise ValueError("its metadata is not an object of texts")
    return metadata


def _check_layout(header: dict[str, Any], data_size: int) -> None:
    """The tensors must lie one behind the other and fill the file."""
    is_count = lambda value: type(value) is int and value >= 0
    places = []
    for name, entry in header.items():
        fields = [entry.get(key) for key in ("dtype", "shape", "data_offsets")] if isinstance(entry, dict) else [None] * 3
        dtype, shape, offsets = fields
        if not isinstance(dtype, str) or dtype not in DTYPES:
            raise ValueError(f"tensor {shown(name)} has the type {shown(dtype)}; known are {', '.join(DTYPES)}")
        if not isinstance(shape, list) or len(shape) > 32 or not all(map(is_count, shape)):
            raise ValueError(f"tensor {shown(name)} has the shape {shown(shape)}")
        # Without numbers a tensor could have lengths that NumPy cannot express.
        if math.prod(max(size, 1) for size in shape) > MAX_FILE_SIZE:
            raise ValueError(f"tensor {shown(name)} is too large: its shape is {shown(shape)}")
        if not isinstance(offsets, list) or len(offsets) != 2 or not all(map(is_count, offsets)):
            raise ValueError(f"tensor {shown(name)} has the data_offsets {shown(offsets)}")
        if offsets[1] - offsets[0] != math.prod(shape) * np.dtype(DTYPES[dtype]).itemsize:
            raise ValueError(f"the data_offsets of tensor {shown(name)} do not fit its shape and type")
        places.append((offsets[0], offsets[1], name))
    end = 0
    for begin, next_end, name in sorted(places):
        if begin != end:
            raise ValueError(f"tensor {shown(name)} does not begin where the one before it ends")
        end = next_end
    if end != data_size:
        raise ValueError(f"it has {shown(data_size)} bytes of tensors, and its header says {shown(end)}")


def _array(entry: dict[str, Any], data: bytearray) -> np.ndarray:
    dtype = np.dtype(DTYPES[entry["dtype"]])
    begin, end = entry["data_offsets"]
    array = np.frombuffer(data, dtype, (end - begin) // dtype.itemsize, begin) if end > begin else np.empty(0, dtype)
    if entry["dtype"] == "BF16":
        array = (array.astype("<u4") << 16).view("<f4")
    return array.reshape(entry["shape"]).astype(array.dtype.newbyteorder("="))


def _check_sha256(path: Path, head: bytes, data: bytearray, metadata: dict[str, str]) -> None:
    """A file of cartpole-dqn holds the SHA-256 of itself, computed with zeros in the place of its digits."""
    # Under another name it is metadata of cartpole-dqn whose name is damaged.
    own = [(name, text) for name, text in metadata.items() if name == METADATA_KEY or text.startswith(METADATA_START)]
    if not own:
        return
    try:
        if own[0][0] != METADATA_KEY:
            raise ValueError
        expected = json.loads(own[0][1])["sha256"].encode()
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise ValueError(f"{path} is damaged: its metadata has no SHA-256") from None
    digest = hashlib.sha256(head.replace(expected, b"0" * 64, 1) if len(expected) == 64 else b"")
    digest.update(data)
    if digest.hexdigest().encode() != expected:
        raise ValueError(f"{path} is damaged: its content does not match the SHA-256 in it")


def write(path: PathLike, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str], first: str = "") -> None:
    """Writes a file. The types must be keys of NAMES. Arrays whose names begin with `first` come first."""
    header: dict[str, Any] = {"__metadata__": dict(metadata)}
    # Types with large numbers first, so that every array begins at a multiple of its numbers' size.
    ordered = sorted(arrays.items(), key=lambda item: (not item[0].startswith(first), -item[1].dtype.itemsize, item[0]))
    contents, end = [], 0
    for name, array in ordered:
        dtype = array.dtype.newbyteorder("<")
        contents.append(np.ascontiguousarray(array, dtype).tobytes())
        begin, end = end, end + len(contents[-1])
        header[name] = {"dtype": NAMES[dtype], "shape": list(array.shape), "data_offsets": [begin, end]}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    with open(path, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text + b"".join(contents))

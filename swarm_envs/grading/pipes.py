"""Messages between the grader and the process of a submission: a JSON header, and arrays.

A message is 16 bytes (`SWRM`, and the lengths of header and arrays, little-endian), the header, and
arrays as safetensors. It cannot contain code. Messages that are too long or malformed are refused.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import IO, Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load, save

_PREFIX = struct.Struct("<4sIQ")
_MAGIC = b"SWRM"
MOST_HEADER = 1 << 16
"""Largest number of bytes of a header."""

Array = npt.NDArray[Any]


class BadMessage(ValueError):
    """The received bytes are not a valid message."""


def send(
    sink: IO[bytes],
    kind: str,
    header: Mapping[str, Any] | None = None,
    arrays: Sequence[Array] = (),
) -> None:
    """Write a message with a header and numeric or boolean arrays.

    Raises:
        OSError: the pipe is closed.
    """
    head = json.dumps({**(header or {}), "kind": kind}).encode()
    numbers = save({str(k): np.ascontiguousarray(array) for k, array in enumerate(arrays)})
    sink.write(_PREFIX.pack(_MAGIC, len(head), len(numbers)) + head + numbers)
    sink.flush()


def receive(source: IO[bytes], most: int) -> tuple[dict[str, Any], list[Array]]:
    """Read a message, and return its header and its arrays.

    Raises:
        BadMessage: it is malformed, or its arrays have more than `most` bytes.
        EOFError: the pipe is closed.
    """
    magic, length, size = _PREFIX.unpack(_read(source, _PREFIX.size))
    if magic != _MAGIC or length > MOST_HEADER or size > most:
        raise BadMessage(f"a message begins with {magic!r} and {length} + {size} bytes")
    try:
        header, numbers = json.loads(_read(source, length)), load(_read(source, size))
        arrays = [numbers[str(k)].copy() for k in range(len(numbers))]
    except (ValueError, TypeError, KeyError, RecursionError, SafetensorError) as error:
        raise BadMessage(f"a message cannot be read: {type(error).__name__}") from error
    if not isinstance(header, dict) or not isinstance(header.get("kind"), str):
        raise BadMessage("a header is no object with a kind")
    return header, arrays


def _read(source: IO[bytes], count: int) -> bytes:
    found = source.read(count)
    if len(found) < count:
        raise EOFError("the other side has ended")
    return found

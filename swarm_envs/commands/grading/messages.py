"""Messages between the grader and the process of a work: a small header, and raw numbers.

A message is 12 bytes (`SWRM`, and the lengths of header and numbers, little-endian), a header in
JSON, and arrays as safetensors. Nothing in it can become code. What is longer than allowed, or does
not fit what it says of itself, is refused.
"""

from __future__ import annotations

import json
import math
import os
import select
import struct
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load, save

_PREFIX = struct.Struct("<4sII")
_MAGIC = b"SWRM"
MOST_HEADER = 1 << 16  # Bytes of a header
MOST_NUMBERS = 1 << 31
"""Bytes of the numbers of a message to the work, which the grader alone sends."""
_CHUNK = 1 << 20  # bytes that are read at once

Array = npt.NDArray[Any]  # Numbers or truth values of a type that safetensors has


class BadMessage(ValueError):
    """What was received is no message."""


class TooLate(RuntimeError):
    """The other side did not take or give a message in time."""


class Channel:
    """Sends messages over one file descriptor and receives them over another.

    Args:
        source: to read from.
        sink: to write to.
    """

    def __init__(self, source: int, sink: int) -> None:
        self._source, self._sink = source, sink
        self._held = bytearray()  # what was read beyond the last message
        os.set_blocking(source, False)
        os.set_blocking(sink, False)

    def send(
        self, header: Mapping[str, Any], arrays: Sequence[Array] = (), until: float = math.inf
    ) -> None:
        """Write a message.

        Args:
            header: what JSON can say.
            arrays: numbers or truth values.
            until: time of `time.monotonic` at which to give up, s.

        Raises:
            TooLate: the other side did not take it in time.
            OSError: there is no other side.
        """
        head = json.dumps(header).encode()
        numbers = save({str(k): np.ascontiguousarray(array) for k, array in enumerate(arrays)})
        left = memoryview(_PREFIX.pack(_MAGIC, len(head), len(numbers)) + head + numbers)
        while left:
            try:
                left = left[os.write(self._sink, left) :]
            except BlockingIOError:  # the pipe is full
                _wait(self._sink, select.POLLOUT, until)

    def receive(
        self, most: int = MOST_NUMBERS, until: float = math.inf
    ) -> tuple[dict[str, Any], list[Array]]:
        """Read a message: its header and its arrays.

        Args:
            most: bytes that its numbers may be.
            until: time of `time.monotonic` at which to give up, s.

        Raises:
            BadMessage: it is longer, or no message.
            TooLate: it did not come in time.
            EOFError: there is no other side.
        """
        if time.monotonic() > until:  # a work that sends without a pause never makes `_wait` look
            raise TooLate("no message in time")
        magic, length, size = _PREFIX.unpack(self._read(_PREFIX.size, until))
        if magic != _MAGIC or length > MOST_HEADER or size > most:
            raise BadMessage(f"begins with {magic!r} and {length} + {size} bytes")
        header = _header(self._read(length, until))
        return header, _arrays(self._read(size, until))

    def _read(self, count: int, until: float) -> bytes:
        while len(self._held) < count:
            try:
                part = os.read(self._source, _CHUNK)
            except BlockingIOError:  # nothing is there yet
                _wait(self._source, select.POLLIN, until)
                continue
            if not part:
                raise EOFError("the other side has ended")
            self._held += part
        read = bytes(self._held[:count])
        del self._held[:count]
        return read


def _wait(descriptor: int, event: int, until: float) -> None:
    """Wait until a descriptor can be read or written."""
    poll = select.poll()
    poll.register(descriptor, event)
    left = until - time.monotonic()
    # A wait of 10 s at most: the system's counter of milliseconds has an end.
    while not poll.poll(max(0.0, min(left, 10.0)) * 1e3):
        left = until - time.monotonic()
        if left <= 0.0:
            raise TooLate("no message in time")


def _header(text: bytes) -> dict[str, Any]:
    try:
        header = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadMessage(f"its header cannot be read: {type(error).__name__}") from error
    if not isinstance(header, dict) or not isinstance(header.get("kind"), str):
        raise BadMessage("its header is no object with a kind")
    return header


def _arrays(numbers: bytes) -> list[Array]:
    try:
        found = load(numbers)
        return [found[str(k)].copy() for k in range(len(found))]
    except (SafetensorError, ValueError, TypeError, KeyError) as error:
        raise BadMessage(f"its numbers cannot be read: {error}") from error

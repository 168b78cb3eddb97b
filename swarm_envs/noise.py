"""Counter-based random numbers for kernels: pure functions of a key and a counter.

A key is sampled from an environment's generator at reset. The numbers of its stream do not depend
on the order in which they are computed, and a snapshot contains only the key.
"""

from __future__ import annotations

import math

import numpy as np

from swarm_envs.compiled import equation, part

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_TWO = np.uint64(2)
_ONE = np.uint64(1)
_UNIT = 2.0**-53
_EVEN_BYTES = np.uint64(0x00FF00FF00FF00FF)
_LOW = np.uint64(0xFFFF)
_S8, _S16, _S32 = np.uint64(8), np.uint64(16), np.uint64(32)
_MEAN = 4 * 255 / 2
_SCALE = 1.0 / math.sqrt(4 * (256**2 - 1) / 12)


@equation
def _mixed(z: np.uint64) -> np.uint64:
    z = (z ^ (z >> _S30)) * _FIRST
    z = (z ^ (z >> _S27)) * _SECOND
    return z ^ (z >> _S31)


@equation
def _unit(random: np.uint64) -> float:
    return (np.float64(random >> _S11) + 0.5) * _UNIT


@part
def uniform(key: np.uint64, counter: np.uint64) -> float:
    """Return number `counter` of the uniform stream `key`, in (0, 1): SplitMix64 (Steele 2014)."""
    return _unit(_mixed(key + (counter + _ONE) * _GOLDEN))


@part
def normal(key: np.uint64, counter: np.uint64) -> float:
    """Return number `counter` of the standard normal stream `key` (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(uniform(key, _TWO * counter)))
    return radius * math.cos(2.0 * math.pi * uniform(key, _TWO * counter + _ONE))


@part
def stream_of(key: np.uint64, member: int) -> np.uint64:
    """Return the state of the stream of a member, one of several that share a key."""
    return _mixed(key ^ _mixed((np.uint64(member) + _ONE) * _GOLDEN))


@equation
def moved(stream: np.uint64, count: int) -> np.uint64:
    """Return the state of a stream after `count` further numbers."""
    return stream + np.uint64(count) * _GOLDEN


@equation
def pair_of_normals(stream: np.uint64, number: int) -> tuple[float, float]:
    """Return two independent numbers of mean 0 and variance 1 from number `number` of a stream.

    Each is the standardized sum of four bytes, bounded by 3.45, with a kurtosis of 2.7 instead
    of 3. Unlike `normal`, it calls no library functions and is vectorized.
    """
    random = _mixed(moved(stream, number + 1))
    twos = (random & _EVEN_BYTES) + ((random >> _S8) & _EVEN_BYTES)
    fours = twos + (twos >> _S32)
    first, second = np.float64(fours & _LOW), np.float64((fours >> _S16) & _LOW)
    return (first - _MEAN) * _SCALE, (second - _MEAN) * _SCALE


@equation
def even_number(stream: np.uint64, number: int) -> float:
    """Return number `number` of a stream, in (0, 1)."""
    return _unit(_mixed(moved(stream, number + 1)))

"""Random numbers inside compiled kernels: pure functions of a key and a counter.

A key is drawn from an environment's generator at reset; from then on number `counter` of its stream
is the same wherever and in whatever order it is computed, and a snapshot need only hold the key.
"""

from __future__ import annotations

import math

import numpy as np

from swarm_envs.compiled import part

__all__ = ["normal"]

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_TWO = np.uint64(2)
_ONE = np.uint64(1)
_UNIT = 2.0**-53


@part
def _mixed(z: np.uint64) -> np.uint64:
    z = (z ^ (z >> _S30)) * _FIRST
    z = (z ^ (z >> _S27)) * _SECOND
    return z ^ (z >> _S31)


@part
def uniform(key: np.uint64, counter: np.uint64) -> float:
    """Number `counter` of the uniform stream `key`, in (0, 1): SplitMix64 (Steele 2014)."""
    z = _mixed(key + (counter + _ONE) * _GOLDEN)
    return (np.float64(z >> _S11) + 0.5) * _UNIT


@part
def normal(key: np.uint64, counter: np.uint64) -> float:
    """Number `counter` of the standard normal stream `key` (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(uniform(key, _TWO * counter)))
    return radius * math.cos(2.0 * math.pi * uniform(key, _TWO * counter + _ONE))

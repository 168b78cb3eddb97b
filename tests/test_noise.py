"""Random streams inside kernels: known numbers, distributions, independence of keys."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from swarm_envs.compiled import kernel
from swarm_envs.noise import even_number, moved, normal, pair_of_normals, stream_of, uniform

MASK = 2**64 - 1


def split_mix(key: int, counter: int) -> float:
    """SplitMix64 with Python's integers, to a double in (0, 1)."""
    z = (key + (counter + 1) * 0x9E3779B97F4A7C15) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    z ^= z >> 31
    return ((z >> 11) + 0.5) * 2.0**-53


@kernel
def uniform_number(key: np.uint64, counter: np.uint64) -> float:
    return uniform(key, counter)


@kernel
def normals(key: np.uint64, count: int) -> np.ndarray:
    out = np.empty(count)
    for k in range(count):
        out[k] = normal(key, np.uint64(k))
    return out


def test_the_generator_is_splitmix64():
    assert split_mix(0, 0) == ((0xE220A8397B1DCDAF >> 11) + 0.5) * 2.0**-53  # published first value
    for key, counter in ((0, 0), (1, 2), (2**63 - 1, 10**6), (12345, 2**40)):
        assert uniform_number(np.uint64(key), np.uint64(counter)) == split_mix(key, counter)


def test_normal_numbers_are_normal_and_keys_independent():
    one, other = normals(np.uint64(1), 20_000), normals(np.uint64(2), 20_000)
    assert stats.kstest(one, "norm").pvalue > 0.01
    assert abs(np.corrcoef(one[:-1], one[1:])[0, 1]) < 0.02
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.02


@kernel
def pairs(key: np.uint64, member: int, count: int) -> np.ndarray:
    out, stream = np.empty((count, 3)), stream_of(key, member)
    for k in range(count):
        out[k, 0], out[k, 1] = pair_of_normals(stream, 0)
        out[k, 2] = even_number(stream, 1)
        stream = moved(stream, 2)
    return out


def test_numbers_of_lanes_have_the_moments_of_normal_ones():
    """Sums of four bytes: bounded, with a kurtosis of 3 - 6/5 / 4."""
    one, other = pairs(np.uint64(9), 0, 200_000), pairs(np.uint64(9), 1, 200_000)
    both = np.concatenate([one, other], axis=1)
    correlation = np.corrcoef(both.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.01
    for column in both[:, [0, 1, 3, 4]].T:
        assert abs(column.mean()) < 0.01 and abs(column.var() - 1.0) < 0.01
        assert stats.kurtosis(column, fisher=False) == pytest.approx(2.7, abs=0.03)
        assert np.abs(column).max() < 3.46
        assert abs(np.corrcoef(column[1:], column[:-1])[0, 1]) < 0.01
    assert stats.kstest(one[:, 2], "uniform").pvalue > 0.01

"""Random streams inside kernels: known numbers, distributions, independence of keys."""

from __future__ import annotations

import numpy as np
from scipy import stats

from swarm_envs.compiled import kernel
from swarm_envs.noise import normal, uniform

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

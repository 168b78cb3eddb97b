"""Is one controller better than another on the same flights? Medians, quartiles, a paired test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import quartiles
from swarm_envs.state import FloatArray

SIGNIFICANT = 0.05
"""Differences with a smaller p are called significant."""


@dataclass(frozen=True)
class Paired:
    """Errors of the same episodes without and with compensation."""

    without: dict[str, float]
    """Median and quartiles, cm."""
    compensated: dict[str, float]
    """The same with compensation."""
    ratio: float
    """Of the medians, compensated over uncompensated."""
    made_worse: int
    """Episodes in which compensation made the error larger."""
    p_value: float
    """Of the hypothesis that compensation changes nothing; see `signed_rank_p`."""

    @property
    def significant(self) -> bool:
        """Whether the difference is more than chance."""
        return self.p_value < SIGNIFICANT

    def as_dict(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {**vars(self), "significant": self.significant}


def compare(without: FloatArray, compensated: FloatArray) -> Paired:
    """Compare errors (E,) of the same E episodes.

    Raises:
        ValueError: they are not as many, or there are none.
    """
    if without.shape != compensated.shape or without.ndim != 1 or not len(without):
        raise ValueError(
            f"errors of shapes {without.shape} and {compensated.shape} are no pairs: give one "
            "number for each episode, of the same episodes"
        )
    before, after = quartiles(without), quartiles(compensated)
    return Paired(
        without=before,
        compensated=after,
        ratio=after["median"] / before["median"],
        made_worse=int((compensated > without).sum()),
        p_value=signed_rank_p(compensated - without),
    )


def signed_rank_p(differences: FloatArray) -> float:
    """Give p of Wilcoxon's signed-rank test, two-sided, of paired differences (E,).

    The hypothesis is that differences are symmetric about 0. Pairs are compared because episodes
    differ more among each other than controllers do, ranks because errors are not normal. Exact for
    up to 50 pairs without ties or zeros, so that n pairs give no smaller p than 2^(1 - n); zeros
    are dropped, and nothing but zeros gives 1.
    """
    from scipy.stats import wilcoxon

    if not np.any(differences):
        return 1.0
    return float(wilcoxon(differences).pvalue)

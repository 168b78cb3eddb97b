"""Motion on ellipses in plain numpy: the truth that compiled references are compared with."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.trajectories import Reference

_RAMP = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 2.5, -3.0, 1.0])
"""Time since rest over the ramp's duration: its slope is a quintic step from 0 to 1."""


def ellipse(
    center: npt.ArrayLike,
    first: npt.ArrayLike,
    second: npt.ArrayLike,
    rate: npt.ArrayLike,
    phase: npt.ArrayLike,
    t: npt.ArrayLike,
    *,
    ramp_time: float,
) -> Reference:
    """center + first cos(angle) + second sin(angle), the rate growing from rest within the ramp."""
    x = np.clip(np.asarray(t) / ramp_time, 0.0, 1.0)
    after = np.maximum(np.asarray(t) - ramp_time, 0.0)
    warp = ramp_time * _RAMP(x) + after
    speeds = [_RAMP.deriv(k)(x) / ramp_time ** (k - 1) for k in (1, 2, 3)]
    angle = (np.asarray(phase) + np.asarray(rate) * warp)[..., None]
    w, dw, ddw = ((np.asarray(rate) * speed)[..., None] for speed in speeds)
    radial = np.asarray(first) * np.cos(angle) + np.asarray(second) * np.sin(angle)
    tangent = np.asarray(second) * np.cos(angle) - np.asarray(first) * np.sin(angle)
    return Reference(
        center + radial,
        tangent * w,
        tangent * dw - radial * w**2,
        tangent * (ddw - w**3) - 3.0 * radial * w * dw,
    )

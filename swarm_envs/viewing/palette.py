"""Colours of drones: one hue a type, one shade a drone."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

from swarm_envs.vehicles import Vehicle

_HUES = {"S": 0.585, "L": 0.072, "S*": 0.405}
_OTHER_HUE = 0.78
_SATURATION = 0.68
_SHADES = (0.40, 0.64)
"""Lightness of the darkest and the palest drone of a type: both stand out from white and black."""
_TYPICAL = 0.52


def type_color(token: str) -> str:
    """The colour, `#rrggbb`, of a type of vehicle."""
    return _hex(token, _TYPICAL)


def drone_colors(team: Sequence[Vehicle]) -> list[str]:
    """A colour, `#rrggbb`, for each drone: shades of its type's, from dark to pale."""
    tokens = [vehicle.token for vehicle in team]
    colors = []
    for i, token in enumerate(tokens):
        count, place = tokens.count(token), tokens[:i].count(token)
        share = place / (count - 1) if count > 1 else 0.5
        colors.append(_hex(token, _SHADES[0] + share * (_SHADES[1] - _SHADES[0])))
    return colors


def _hex(token: str, lightness: float) -> str:
    hue = _HUES.get(token, _OTHER_HUE)
    parts = colorsys.hls_to_rgb(hue, lightness, _SATURATION)
    return "#" + "".join(f"{round(255 * part):02x}" for part in parts)

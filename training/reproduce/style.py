"""The look of the reproduced figures: that of every picture, and a colour for each scenario."""

from swarm_envs.viewing.style import (
    GREY,
    INK,
    draw_drone,
    draw_ground,
    force_colors,
    picture,
)

__all__ = ["COLORS", "GREY", "INK", "draw_drone", "draw_ground", "force_colors", "picture"]

COLORS = {"S2S": "#0072B2", "L2S": "#D55E00", "S2L": "#009E73", "L2L": "#CC79A7"}
"""Okabe and Ito's palette, which colour-blind readers can tell apart, by scenario."""
COLORS |= {"Ge2S": "#56B4E9", "Ge2L": "#E69F00"}

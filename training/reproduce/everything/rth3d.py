"""The figures of RTH3D, which has no tables, and the commands that remake them."""

from __future__ import annotations

from swarm_envs.training.reproduce.everything import rth3d_rows as rows
from swarm_envs.training.reproduce.everything.item import Item, Words

PAPER = "rth3d"
"""As `swarm-envs reproduce` names the paper."""


def _remade(figure: str, *words: str) -> tuple[Words, ...]:
    """One command of this paper, its numbers as JSON too."""
    start = ("reproduce", PAPER, "--out", "{out}", "--json", "{out}/points.json")
    return ((*start, "--figure", figure, *words),)


def _planned(number: str, shows: str, largest: int, note: str = "") -> Item:
    """A figure of curves; the quick one ends at grids of so many vertices."""
    return Item(
        paper=PAPER,
        name=f"figure-{number}",
        label=f"Fig. {number}",
        shows=shows,
        full=_remade(number),
        quick=_remade(number, "--runs", "3", "--budget", "80000", "--largest", str(largest)),
        read=getattr(rows, f"figure_{number}"),
        pictures=(f"figure_{number}.png",),
        note=note,
    )


def _drawn(number: int, shows: str, missing: str) -> Item:
    """A figure that nothing remakes."""
    name, label = f"figure-{number}", f"Fig. {number}"
    return Item(paper=PAPER, name=name, label=label, shows=shows, missing=missing)


ITEMS = (
    _drawn(
        1,
        "a light show; a swarm between tall buildings in Unity",
        "a photograph, and a picture of another simulator; such buildings are planned in Fig. 7",
    ),
    _drawn(
        2,
        "a Rubik table of 27 items sorted by shuffles",
        "an illustration of the method; nothing is measured",
    ),
    _drawn(
        3,
        "a random configuration on 6 x 6 x 3, balanced",
        "an illustration of the method; nothing is measured",
    ),
    _drawn(
        4,
        "one plane sorted by shuffles along its lanes",
        "an illustration of the method; nothing is measured",
    ),
    _planned(
        "5", "time and ratio of makespan to lower bound on 4:2:1 grids, a third taken", 70_000
    ),
    _planned("6", "the same on square grids six vertices high", 60_000),
    _planned("7", "the same between tall buildings", 50_000),
    _planned("8", "the same on 120 x 60 x 6 by the number of robots", 50_000),
    _planned("9", "rings and blocks, and their ratios", 50_000),
    _drawn(
        10,
        "not known",
        "the text that we have of the paper holds neither this picture, nor its caption, nor a "
        "reference to it",
    ),
    Item(
        paper=PAPER,
        name="figure-11",
        label="Fig. 11",
        shows="ten Crazyflies write A-R-C-R-U on 6 x 6 x 6 grids",
        full=_remade("11"),
        read=rows.figure_11,
        pictures=("figure_11.png",),
        note="Flown in simulation, in learned downwash; theirs is a photograph of real drones.",
    ),
)
"""Every numbered figure of the paper; it has no table."""

"""The figures of DMPC-Swarm, which has no tables, and the commands that remake them."""

from __future__ import annotations

from swarm_envs.training.reproduce.everything import dmpc_swarm_rows as rows
from swarm_envs.training.reproduce.everything.item import Item, Words

PAPER = "dmpc-swarm"
"""As `swarm-envs reproduce` names the paper."""
_NUMBERS = (
    "The paper prints no numbers; those in its column are of the authors' public simulation, on "
    "formations of its own."
)


def _remade(figure: str, *words: str) -> tuple[Words, ...]:
    """One command of this paper, into the item's folder."""
    return (("reproduce", PAPER, "--out", "{out}", "--figure", figure, *words),)


def _flown(name: str, shows: str, seeds: int, note: str = "") -> Item:
    """A figure that is flown; replay pages are left to the command by itself."""
    return Item(
        paper=PAPER,
        name=f"figure-{name}",
        label=f"Fig. {name}",
        shows=shows,
        full=_remade(name, "--seeds", str(seeds)),
        quick=_remade(name, "--seeds", "1", "--no-replay"),
        read=getattr(rows, f"figure_{name}"),
        pictures=(f"figure_{name}.png",),
        note=note,
    )


ITEMS = (
    Item(
        paper=PAPER,
        name="figure-1",
        label="Fig. 1",
        shows="the swarm, its radio, and the phases of a round",
        missing="an overview drawing: nothing is measured",
    ),
    Item(
        paper=PAPER,
        name="figure-2",
        label="Fig. 2",
        shows="sixteen Crazyflies, three laptops and their radios",
        missing="a photograph of the hardware",
    ),
    Item(
        paper=PAPER,
        name="figure-3a",
        label="Fig. 3a",
        shows="the formations that are flown: plane, pyramid, cube, sphere",
        full=_remade("3a"),
        read=rows.figure_3a,
        pictures=("figure_3a.png",),
    ),
    _flown("3b", "those formations with one, two and three compute units", 3, _NUMBERS),
    _flown("3c", "the same with each event trigger", 3, _NUMBERS),
    _flown("4", "sixteen drones across a circle while no compute unit hears for two seconds", 3),
)
"""Every numbered figure of the paper; it has no table."""

"""The tables and figures of Neural-Swarm2, and the commands that remake them."""

from __future__ import annotations

from swarm_envs.training.reproduce.everything import neural_swarm_rows as rows
from swarm_envs.training.reproduce.everything import neural_swarm_tables as tables
from swarm_envs.training.reproduce.everything.item import Item, Words

PAPER = "neural-swarm2"
"""As `swarm-envs reproduce` names the paper."""
_REMAKE: Words = ("reproduce", PAPER, "--out", "{out}")
_SIX = ("--episodes", "6", "--engine", "batch")
"""The paper flies six swaps of each case."""


def _remade(*words: str) -> tuple[Words, ...]:
    """One command of this paper, into the item's folder."""
    return ((*_REMAKE, *words),)


def _collect(flights: int) -> Words:
    """Flights of each team and motion: the rows of measured force where none are given."""
    count = str(flights)
    words = ("--walks", count, "--low-walks", count, "--swaps", count, "--low-swaps", count)
    return ("collect", "--out", "{out}/flights", "--json", "{out}/flights.json", *words)


def _table_3(flights: int, *words: str) -> tuple[Words, ...]:
    return (_collect(flights), *_remade("--table", "3", "--data", "{data}", *words))


ITEMS = (
    Item(
        paper=PAPER,
        name="figure-1",
        label="Fig. 1",
        shows="sixteen drones on intertwined rings, with and without compensation (b, c); "
        "(a) is a photograph",
        full=_remade("--figure", "1"),
        quick=_remade("--figure", "1", *_SIX),
        read=rows.rings,
        pictures=("figure_1.png",),
    ),
    Item(
        paper=PAPER,
        name="figure-2",
        label="Fig. 2",
        shows="the idea of the proof of Theorem 4",
        missing="a drawing of two maps between sets: nothing is measured",
    ),
    Item(
        paper=PAPER,
        name="figure-3",
        label="Fig. 3",
        shows="a search tree of stage 1 of the planner, coloured by force",
        missing="an illustration without numbers; what that search ends in is Fig. 6, left",
    ),
    Item(
        paper=PAPER,
        name="figure-4",
        label="Fig. 4",
        shows="how planner, controllers and vehicle hang together",
        missing="a block diagram: nothing is measured",
    ),
    Item(
        paper=PAPER,
        name="figure-5",
        label="Fig. 5",
        shows="heat maps of the force on a small drone, eight surroundings",
        full=_remade("--figure", "5"),
        read=rows.heat_maps,
        pictures=("figure_5.png", "superposition_gaps.png"),
    ),
    Item(
        paper=PAPER,
        name="figure-6",
        label="Fig. 6",
        shows="a swap of two small robots and a large one, planned with and without the forces",
        full=_remade("--figure", "6"),
        quick=_remade("--figure", "6", "--trials", "2", "--engine", "batch"),
        read=rows.planned_swap,
        pictures=("figure_6.png",),
    ),
    Item(
        paper=PAPER,
        name="figure-7",
        label="Fig. 7",
        shows="worst errors and forces of random swaps, planned with and without the forces",
        full=_remade("--figure", "7"),
        quick=_remade(
            *("--figure", "7", "--trials", "2", "--engine", "batch"),
            *("--scenarios", "SL", "LL", "SSL"),
        ),
        read=rows.planned_trials,
        pictures=("figure_7.png",),
        note="On the planner's own model of the forces, tracked by a PID without compensation, as "
        "in the paper.",
    ),
    Item(
        paper=PAPER,
        name="figure-8",
        label="Fig. 8",
        shows="worst height error of stacked swaps with and without compensation",
        full=_remade("--figure", "8"),
        quick=_remade("--figure", "8", *_SIX),
        read=rows.swaps,
        pictures=("figure_8.png",),
    ),
    Item(
        paper=PAPER,
        name="figure-9",
        label="Fig. 9",
        shows="five drones on intertwined rings, and the force that is predicted there",
        full=_remade("--figure", "9"),
        quick=_remade("--figure", "9", *_SIX),
        read=rows.rings,
        pictures=("figure_9.png",),
    ),
    Item(
        paper=PAPER,
        name="table-1",
        label="Table I",
        shows="mass, largest thrust, motor rate and thrust curves of both quadrotors",
        full=_remade("--table", "1"),
        read=tables.vehicles,
        pictures=("table_1.png",),
        note="Identified anew on simulated vehicles, from thrust, acceleration and a noisy load "
        "cell, as if nothing of them were known.",
    ),
    Item(
        paper=PAPER,
        name="table-2",
        label="Table II",
        shows="the twelve scenarios of the data collection",
        full=(_collect(60),),
        quick=(_collect(2),),
        read=tables.scenarios,
    ),
    Item(
        paper=PAPER,
        name="table-3",
        label="Table III",
        shows="validation error by width H and depth L of the networks, and without velocities",
        full=_table_3(20),
        quick=_table_3(3, "--steps", "400", "--seeds", "1"),
        read=tables.ablation,
        pictures=("table_3.png",),
        note="Fitted to the rows given by --data, or to flights collected in simulation where none "
        "are given: the authors' flights are not part of the package.",
    ),
)
"""Every numbered table and figure of the paper."""

"""Synthetic tables and figures: what `swarm-envs reproduce all` would have run, without running."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from pathlib import Path

from swarm_envs.training.reproduce.everything.item import Item, Preset
from swarm_envs.training.reproduce.everything.rows import Range, Reason, Row, about
from swarm_envs.training.reproduce.everything.runner import Job, Outcome

PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8z8BQDwAEhQGAhKmMIQAAAABJRU5ErkJggg=="
)
"""The smallest PNG."""
ROWS = (
    Row(quantity="error, cm", paper="17", ours=16.0, agrees=about(17.0, 0.3)),
    Row(
        quantity="error with `belief`, cm",
        paper="7",
        ours=0.5,
        spread=(0.4, 0.6),
        spread_is="quartiles",
        agrees=about(7.0, 0.3),
        reasons=(Reason("calmer <air> & better models", Range(0.0, 7.0)),),
    ),
    Row(quantity="robots", paper="12", ours=3.0, agrees=Range(12.0, 12.0)),
    Row(quantity="least distance, m", paper="-", ours=0.25),
)
"""One row of each verdict."""


def read(folder: Path, preset: Preset) -> Sequence[Row]:
    """The rows, the first of which holds what the command wrote."""
    value = json.loads((folder / "value.json").read_text())
    first = Row(quantity="value", paper="1", ours=value, agrees=about(1.0, 0.1))
    return (first, *ROWS)


def item(name: str, *words: str, pictures: tuple[str, ...] = ()) -> Item:
    """A figure remade by `write OUT` and more words."""
    return Item(
        paper="paper",
        name=name,
        label=f"Fig. {name}",
        shows="a <b>bold</b> thing & more",
        full=(("write", "{out}", *words),),
        read=read,
        pictures=pictures,
    )


MISSING = Item(
    paper="paper", name="photo", label="Fig. 0", shows="drones", missing="a photograph <here>"
)
"""A figure that nothing remakes."""


class Written:
    """Executes `write OUT [fail | stop | die]`, and keeps what it was asked for."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.heals = False

    def __call__(self, words: Sequence[str]) -> int:
        """Write the value, or go wrong as the words say."""
        folder, ways = Path(words[1]), () if self.heals else words[2:]
        self.asked.append(folder.name)
        if "stop" in ways:
            return 130
        if "die" in ways:
            raise RuntimeError("no <air>")
        if "fail" in ways:
            return 1
        (folder / "value.json").write_text("1.05")
        (folder / "a.png").write_bytes(PIXEL)
        return 0


def job(out: Path, execute: Written) -> Job:
    """A run into a folder."""
    return Job(out, "full", None, execute)


def outcomes(out: Path) -> list[Outcome]:
    """One of each state, the finished one with a picture in its folder."""
    shown = item("one", pictures=("a.png",))
    folder = out / shown.key
    folder.mkdir(parents=True)
    (folder / "a.png").write_bytes(PIXEL)
    command = "swarm-envs reproduce paper --out 'a b' --figure 1 > <nowhere> && " + "long " * 60
    return [
        Outcome(shown, "done", (command,), ROWS, 12.0),
        Outcome(item("two"), "failed", (command,), (), 1.0, "no <script>alert(1)</script>"),
        Outcome(item("three"), "not run", (command,)),
        Outcome(MISSING, "not remade"),
    ]

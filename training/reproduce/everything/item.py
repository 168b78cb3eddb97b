"""A table or figure of a paper: what remakes it, and how what was measured is read."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from swarm_envs.training.reproduce.everything.rows import Row

Preset = Literal["quick", "full"]
"""Few runs of small cases, or what the papers' figures have."""

Words = tuple[str, ...]
"""A command after `swarm-envs`; `{out}` stands for the item's folder, `{data}` for the rows of
measured force."""


@dataclass(frozen=True, kw_only=True)
class Item:
    """A numbered table or figure."""

    paper: str
    """As `swarm-envs reproduce` names it."""
    name: str
    """Such as `figure-3b` or `table-1`."""
    label: str
    """As the paper names it."""
    shows: str
    """What it shows, in a line."""
    missing: str = ""
    """Why it cannot be remade in simulation; empty if it can."""
    full: tuple[Words, ...] = ()
    """Commands that remake it, one after another."""
    quick: tuple[Words, ...] = ()
    """The same in little time; as `full` if there are none."""
    read: Callable[[Path, Preset], Sequence[Row]] | None = None
    """Takes its folder and the preset, and gives the rows; raises what reading raises."""
    pictures: tuple[str, ...] = ()
    """Ours, in its folder."""
    note: str = ""
    """What a reader must know beside the rows."""

    def __post_init__(self) -> None:
        """Refuse an item that is half made.

        Raises:
            ValueError: neither commands nor a reason why there are none, or both.
        """
        if bool(self.missing) == bool(self.full):
            raise ValueError(f"{self.key}: give commands, or why there are none, and not both")
        if self.full and self.read is None:
            raise ValueError(f"{self.key}: say how its rows are read")

    @property
    def takes_data(self) -> bool:
        """Whether it is made from rows of measured force that may be given."""
        return any("{data}" in words for words in self.full)

    @property
    def key(self) -> str:
        """Such as `neural-swarm2/table-3`: its folder, and how it is asked for."""
        return f"{self.paper}/{self.name}"

    def commands(
        self, preset: Preset, out: Path, data: Path | None = None, seed: int = 0
    ) -> list[list[str]]:
        """The commands' words, places filled in.

        Args:
            preset: how much is run.
            out: of the item.
            data: rows of measured force; where there are none, `collect` flies for them.
            seed: of every command; 0 is what they take by themselves.
        """
        chosen = self.quick if preset == "quick" and self.quick else self.full
        rows = str(data) if data is not None else f"{out}/flights/rows.npz"
        given = self.takes_data and data is not None
        wanted = [words for words in chosen if not (given and words[0] == "collect")]
        drawn = ["--seed", str(seed)] if seed else []
        return [[*(word.format(out=out, data=rows) for word in w), *drawn] for w in wanted]


def shell(words: Sequence[str]) -> str:
    """A command as one types it."""
    return shlex.join(["swarm-envs", *words])

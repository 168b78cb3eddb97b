"""Synthetic tables and figures for the runner of studies, and real ones run quietly."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from swarm_envs.training.reproduce.claims import Between, Claim, Extent, Reason, about
from swarm_envs.training.reproduce.papers import load_paper
from swarm_envs.training.reproduce.reproduce_all import ReproduceAllOptions, StudyOutcome
from swarm_envs.training.reproduce.study import Report, Study, StudyOptions, run_study

PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8z8BQDwAEhQGAhKmMIQAAAABJRU5ErkJggg=="
)
"""The smallest PNG."""
CLAIMS = (
    Claim("error, cm", "17", 16.0, about(17.0, 0.3)),
    Claim(
        "error with `belief`, cm",
        "7",
        0.5,
        about(7.0, 0.3),
        (Reason("calmer <air> & better models", Between(0.0, 7.0)),),
        spread=(0.4, 0.6),
        spread_is="quartiles",
    ),
    Claim("robots", "12", 3.0, Between(12.0, 12.0)),
    Claim("least distance, m", "-", 0.25),
)
"""One claim of each agreement."""


@dataclass(frozen=True, kw_only=True)
class TinyOptions(StudyOptions):
    """Options of a paper that is not there."""

    paper: ClassVar[str] = "paper"

    figure: Literal["a", "b", "c"] | None = None  # letter of the figure


OPTIONS = TinyOptions
STUDIES: list[Study] = []


class Runs:
    """Counts what is run, and goes wrong as `fails` says by the letter of the figure."""

    def __init__(self, **fails: BaseException) -> None:
        self.asked: list[str] = []
        self.fails = fails

    def report(self, options: TinyOptions, cells: Mapping[str, Any]) -> Report:
        """The value 1.05 and a picture, or what goes wrong."""
        letter = str(options.figure)
        self.asked.append(letter)
        if letter in self.fails:
            raise self.fails[letter]
        return Report({"value": 1.05}, "said", files={f"{letter}.png": write_pixel})

    def study(self, letter: str, pictures: tuple[str, ...] = ()) -> Study:
        """A figure that this runs, in the place of the last with that letter."""
        study = Study(
            paper="paper",
            name=f"figure-{letter}",
            label=f"Fig. {letter}",
            shows="a <b>bold</b> thing & more",
            report=self.report,
            claims=claims_of,
            pictures=pictures,
        )
        STUDIES[:] = [s for s in STUDIES if s.name != study.name] + [study]
        return study


def write_pixel(path: Path) -> None:
    """The smallest picture."""
    path.write_bytes(PIXEL)


def claims_of(numbers: Any, extent: Extent) -> list[Claim]:
    """The claims, the first of which holds what was measured."""
    return [Claim("value", "1", numbers["value"], about(1.0, 0.1)), *CLAIMS]


MISSING = Study(
    paper="paper", name="photo", label="Fig. 0", shows="drones", missing="a photograph <here>"
)
"""A figure that nothing remakes."""


def outcomes(out: Path) -> list[StudyOutcome]:
    """One of each state, the finished one with a picture in its folder."""
    make = Runs().study
    shown = make("a", ("a.png",))
    (out / shown.key).mkdir(parents=True)
    write_pixel(out / shown.key / "a.png")
    command = "swarm-envs reproduce paper --out 'a b' --figure 1 > <nowhere> && " + "long " * 60
    return [
        StudyOutcome(shown, "done", (command,), CLAIMS, 12.0),
        StudyOutcome(make("b"), "failed", (command,), (), 1.0, "no <script>alert(1)</script>"),
        StudyOutcome(make("c"), "not run", (command,)),
        StudyOutcome(MISSING, "not remade"),
    ]


def everything_into(out: Path) -> ReproduceAllOptions:
    """Options of `reproduce all`."""
    return ReproduceAllOptions(out=out)


def run_quietly(paper: str, **asked: Any) -> tuple[dict[str, Any], str]:
    """Run a study without a progress bar; give its numbers and what it prints."""
    options = load_paper(paper).OPTIONS(**asked)
    return run_study(options.chosen, options, progress=False)

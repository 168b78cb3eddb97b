"""What is reproduced of Neural-Swarm2: the options of the command, and every table and figure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar, Literal

from swarm_envs.arguments import Count, Seed, typed
from swarm_envs.training.reproduce.ablation import ABLATIONS, TABLE_3
from swarm_envs.training.reproduce.ball_study import BALL
from swarm_envs.training.reproduce.collected_flights import TABLE_2
from swarm_envs.training.reproduce.force_map_figure import FIGURE_5
from swarm_envs.training.reproduce.hall_study import HALL
from swarm_envs.training.reproduce.identified_vehicles import TABLE_1
from swarm_envs.training.reproduce.lag_study import LAG
from swarm_envs.training.reproduce.limits_study import LIMITS
from swarm_envs.training.reproduce.paired_flight_figures import FIGURE_1, FIGURE_8, FIGURE_9
from swarm_envs.training.reproduce.paired_flights import SWAPS
from swarm_envs.training.reproduce.planned_swap_figures import FIGURE_6, FIGURE_7
from swarm_envs.training.reproduce.planned_swaps import SCENARIOS, TRIALS
from swarm_envs.training.reproduce.study import StudyOptions, drawing

_PAPER = "neural-swarm2"  # as `swarm-envs reproduce` names the paper


@partial(typed, owner="--")
@dataclass(frozen=True, kw_only=True)
class NeuralSwarmOptions(StudyOptions):
    """Reproduce a figure or a table of Neural-Swarm2, with the paper's values.

    `--table 1` identifies both vehicles again.
    `--figure 5` draws the heat maps, the superposition gaps and larger swarms of any force model.
    `--figure 8` flies stacked swaps with and without
    compensation, `--figure 9` the rings of 5, `--figure 1` those of 16, in environments whose force
    the controllers do not know. `--figure 6` and `--figure 7` plan swaps with and without knowing
    the forces. `--table 3` fits the ablations. `--study` looks at what the
    controller claims, and at where compensation ends. What takes a while resumes when
    it is interrupted and run again.
    """

    paper: ClassVar[str] = _PAPER

    figure: Literal[1, 5, 6, 7, 8, 9] | None = None
    """number of the figure"""
    table: Literal[1, 3] | None = None
    """number of the table"""
    study: Literal["lag", "ball", "limits", "hall"] | None = None
    """lag compensation on and off; the ball of Theorem 5; the limits of compensation; what each
    part of the hall costs"""
    seed: Seed = 0
    """table: seed of the first run of each cell; flights: seeds are drawn from it; figure 5: of the
    swarms that `--truth` asks about"""
    truth: str | None = None
    """flights: the true force model, `learned`, `wake` or a path of weights; both of those with a
    belief of their own if not given. Figure 5: the true force where the model was learned: how
    much of it is explained for 2 to 16 drones"""
    world: Literal["ideal", "hall"] | None = None
    """figures 1, 8 and 9: `ideal` or `hall`; both if not given"""
    belief: Path | None = None
    """flights: weights of the compensating controller's force model, such as those of `swarm-envs
    curriculum`; the included one for `--truth` if not given"""
    episodes: Count | None = None
    """flights: how many of each case by each controller; 20 if not given"""
    engine: Literal["bullet", "batch"] | None = None
    """flights: who computes them; Bullet where it can be imported, if not given"""
    cases: tuple[str, ...] = SWAPS
    """figure 8: teams, the lowest drone last"""
    radius_m: float = 0.5
    """figure 8: radius of the circle that the drones cross"""
    duration_s: float = 4.0
    """figure 8: time of a crossing"""
    scenarios: tuple[str, ...] = SCENARIOS
    """figure 7: teams that exchange positions"""
    trials: Count = TRIALS
    """figure 7: random swaps of each team; figure 6: seeds with which its swap is planned"""
    model: str = "learned"
    """figure 5: `learned`, `wake`, or the path of a weights file"""
    data: Path | None = None
    """table: rows of measured force, a file or a folder, as `swarm-envs fit` reads them"""
    seeds: Count = 3
    """table: runs of each cell"""
    cells: tuple[str, ...] = tuple(ABLATIONS)
    """table: which cells to fit"""
    steps: Count | None = None
    """table: optimiser steps of each fit; the trainer's default if not given"""

    @property
    def truths(self) -> tuple[str, ...]:
        """The forces that are flown in: if none is named, those for which a belief ships."""
        return ("learned", "wake") if self.truth is None else (self.truth,)


OPTIONS = NeuralSwarmOptions  # What `swarm-envs reproduce neural-swarm2` takes


STUDIES = (
    FIGURE_1,
    drawing(
        _PAPER,
        2,
        "the idea of the proof of Theorem 4",
        "a drawing of two maps between sets: nothing is measured",
    ),
    drawing(
        _PAPER,
        3,
        "a search tree of stage 1 of the planner, coloured by force",
        "an illustration without numbers; what that search ends in is Fig. 6, left",
    ),
    drawing(
        _PAPER,
        4,
        "how planner, controllers and vehicle hang together",
        "a block diagram: nothing is measured",
    ),
    FIGURE_5,
    FIGURE_6,
    FIGURE_7,
    FIGURE_8,
    FIGURE_9,
    TABLE_1,
    TABLE_2,
    TABLE_3,
    LAG,
    BALL,
    LIMITS,
    HALL,
)
"""Every numbered table and figure of the paper, and other studies."""

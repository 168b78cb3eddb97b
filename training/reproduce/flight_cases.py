"""The cases of Neural-Swarm2's flight tests (Sec. VII-E), with the numbers that the paper gives.

Fig. 8: stacked swaps. Its text names the notation (`SL2S`: small and large above small), the
number of swaps (6), and one median; `S*` is a small drone with stronger motors, flown where the
downwash was too much for a plain one: here wherever the lowest drone is a small one.

Fig. 9 and 1: rings of 5 and 16. Radii, speeds and phases are not published; ours are those of
`ring_v0` (see `swarm_envs.tasks.ring`), whose phases are locked.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from swarm_envs.baselines.neural_swarm.flights import FlightTest, swap_test
from swarm_envs.interactions import InteractionModel
from swarm_envs.tasks.ring import RingTask, ring_team
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.vehicles import team_string

PLAIN_SWAPS = ("S2S", "L2S", "S2L", "L2L", "SS2S", "SL2S", "LL2S", "SS2L", "SL2L", "LL2L")
"""Teams of Fig. 8, the lowest drone last."""
STRONG_SWAPS = ("S2S*", "L2S*", "SS2S*", "SL2S*", "LL2S*")
"""The same with stronger motors for the small drone that is blown on."""
SWAPS = (*PLAIN_SWAPS, *STRONG_SWAPS)
"""Every case of Fig. 8."""
RING_SIZES = {9: 5, 1: 16}
"""Drones of the rings by number of the figure."""


@dataclass(frozen=True)
class Case:
    """One team on one motion."""

    name: str
    """Such as `L2S`, or `ring of 5`."""
    test: FlightTest
    """What is flown, in which air."""
    judged: int | None
    """Index of the drone whose error counts; None for the worst of each flight."""
    paper_cm: tuple[float, float] | None = None
    """The paper's error without and with compensation, if it gives one."""


def swap_case(
    name: str, layout: StackedLayout, truth: str | Path | InteractionModel, engine: str
) -> Case:
    """A case of Fig. 8: judged by its lowest drone."""
    paper = (17.0, 7.0) if name == "L2S" else None  # medians of six swaps
    return Case(name, swap_test(name, layout, truth, engine), -1, paper)


def ring_case(figure: int, truth: str | Path | InteractionModel, engine: str) -> Case:
    """The rings of Fig. 9 or Fig. 1: judged by the worst drone of each flight."""
    task = RingTask(ring_team(RING_SIZES[figure]))
    paper = {9: (10.0, 5.0), 1: (15.0, 10.0)}[figure]  # of one drone on an upright ring
    return Case(f"ring of {len(task.team)}", FlightTest(task, truth, engine), None, paper)


def settings_of(case: Case) -> dict[str, object]:
    """What decides on a case's flights beside controllers, seeds and force: ready for JSON."""
    task = case.test.task
    layout = task.layout if isinstance(task, RingTask) else getattr(task, "stacked", None)
    return {
        "case": case.name,
        "team": team_string(task.team),
        "engine": case.test.engine,
        "layout": repr(layout),
        "seconds": case.test.seconds,
        "decision_rate": case.test.decision_rate,
    }

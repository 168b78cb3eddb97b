"""Judging a decision that has been flown: errors, crashes, success, and whether it is over.

One compiled pass, since a dozen numpy calls on arrays of four numbers would take as long as the
flight itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.physics.contact import NO_DRONE, Contacts
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tasks.base import Mission, Situation
from swarm_envs.tasks.metrics import Record, measure

_ROUNDING = 1e-9


class Rules(NamedTuple):
    """When an episode is won, and when it ends."""

    radius: float
    """How near a drone must be to its goal, m."""
    hold_s: float
    """For how long all must stay there, s."""
    decision_s: float
    """Time between decisions, s."""
    horizon_s: float
    """The clock, s."""
    end_on_success: bool
    """Whether success ends the episode."""
    bounded: bool
    """Whether actions lie in [-1, 1], so that their size is an effort."""


class Verdict(NamedTuple):
    """What the judge says of the last decision: arrays that lead with E."""

    crashed: BoolArray
    """(E, N) has collided, left the arena or tumbled in this episode."""
    succeeded: BoolArray
    """(E,) the task is done."""
    just_succeeded: BoolArray
    """(E,) it was done in this decision."""
    terminated: BoolArray
    """(E,) ended by a crash or by success."""
    truncated: BoolArray
    """(E,) ended by the clock."""
    last_distance: FloatArray
    """(E, N) distance to the goal one decision earlier, m."""
    error: FloatArray
    """(E, N) distance to the reference, m."""
    effort: FloatArray
    """(E, N) mean square of the action; 0 where actions are unbounded."""

    def clear(self, mask: BoolArray) -> None:
        """Begin anew in the environments of the mask."""
        for array in self:
            array[mask] = 0

    def situation(self, mission: Mission, contacts: Contacts) -> Situation:
        """What rewards are computed from."""
        return Situation(
            distance=mission.distance,
            last_distance=self.last_distance,
            tracking_error=self.error,
            effort=self.effort,
            clearance=contacts.clearance,
            crashed=self.crashed,
            succeeded=self.just_succeeded,
        )


def new_verdict(num_envs: int, num_drones: int) -> Verdict:
    """The verdict on environments that have not begun."""
    shape = (num_envs, num_drones)
    return Verdict(
        crashed=np.zeros(shape, dtype=np.bool_),
        succeeded=np.zeros(num_envs, dtype=np.bool_),
        just_succeeded=np.zeros(num_envs, dtype=np.bool_),
        terminated=np.zeros(num_envs, dtype=np.bool_),
        truncated=np.zeros(num_envs, dtype=np.bool_),
        last_distance=np.zeros(shape),
        error=np.zeros(shape),
        effort=np.zeros(shape),
    )


@kernel
def judge(
    actions: FloatArray,
    time: FloatArray,
    position: FloatArray,
    reference: FloatArray,
    contacts: Contacts,
    rules: Rules,
    mission: Mission,
    record: Record,
    verdict: Verdict,
    running: BoolArray,
) -> None:
    """Judge the decision that every running environment has just flown.

    Args:
        actions: (E, N, width), what was decided.
        time: (E,) s.
        position: (E, N, 3) m.
        reference: (E, N, 3) where drones should be, m.
        contacts: of this decision.
        rules: of success and end.
        mission: its distances are updated.
        record: updated.
        verdict: written.
        running: (E,) environments to judge; those that have ended are taken out.
    """
    drones, width = actions.shape[1], actions.shape[2]
    for e in range(actions.shape[0]):
        verdict.just_succeeded[e] = False
        if not running[e]:
            continue
        for i in range(drones):
            verdict.last_distance[e, i] = mission.distance[e, i]
            if rules.bounded:
                square = 0.0
                for k in range(width):
                    square += actions[e, i, k] * actions[e, i, k]
                verdict.effort[e, i] = square / width
        error = verdict.error[e]
        measure(e, position, reference, contacts, mission, time, rules.radius, record, error)
        since, crashed = 0.0, False
        for i in range(drones):
            touched = contacts.drone[e, i] != NO_DRONE or contacts.floor[e, i]
            verdict.crashed[e, i] |= touched or contacts.wall[e, i] or contacts.tumbling[e, i]
            crashed |= verdict.crashed[e, i]
            since = max(since, record.arrival[e, i])
        if not crashed and time[e] - since >= rules.hold_s - _ROUNDING:
            verdict.just_succeeded[e] = not verdict.succeeded[e]
            verdict.succeeded[e] = True
        over = crashed or (rules.end_on_success and verdict.succeeded[e])
        verdict.terminated[e] = over
        verdict.truncated[e] = not over and time[e] >= rules.horizon_s - _ROUNDING
        running[e] = not (over or verdict.truncated[e])

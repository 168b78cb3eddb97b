"""Judging a decision that has been flown: errors, crashes, success, and whether it is over.

One compiled pass, since a dozen numpy calls on arrays of four numbers would take as long as the
flight itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.physics.contact import NO_DRONE, NO_OBSTACLE, Contacts
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tasks.base import Situation, Success, TrackingSuccess
from swarm_envs.tasks.metrics import Record, clear_record, measure
from swarm_envs.tasks.mission import Mission, begin_mission
from swarm_envs.tasks.motion import stage_at

_ROUNDING = 1e-9


class Rules(NamedTuple):
    """When an episode is won, and when it ends."""

    tracks: bool
    """Whether the goals are wherever the reference is, to be kept to until the clock ends."""
    radius: float
    """How near a drone must be to its goal, or always to its reference, m."""
    hold_s: float
    """For how long all must stay there, s."""
    settle_s: float
    """Errors count from this time on, s."""
    stage_s: float
    """Seconds that each stage lasts."""
    decision_s: float
    """Time between decisions, s."""
    horizon_s: float
    """The clock, s."""
    end_on_success: bool
    """Whether success ends the episode."""
    bounded: bool
    """Whether actions lie in [-1, 1], so that their size is an effort."""


def success_rules(success: Success | TrackingSuccess) -> tuple[bool, float, float, float]:
    """The first four of the `Rules`, of a task's success."""
    if isinstance(success, TrackingSuccess):
        return True, float(success.worst_error), 0.0, float(success.settle_s)
    return False, float(success.radius), float(success.hold_s), 0.0


class Verdict(NamedTuple):
    """What the judge says of the last decision: arrays that lead with E."""

    crashed: BoolArray
    """(E, N) has collided, left the arena or tumbled in this episode."""
    succeeded: BoolArray
    """(E,) the task is done."""
    achieved: FloatArray
    """(E,) the share of it that was done in this decision."""
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

    def situation(self, mission: Mission, contacts: Contacts) -> Situation:
        """What rewards are computed from."""
        return Situation(
            distance=mission.distance,
            last_distance=self.last_distance,
            tracking_error=self.error,
            effort=self.effort,
            clearance=contacts.clearance,
            crashed=self.crashed,
            obstacle_clearance=contacts.obstacle_clearance,
            achieved=self.achieved,
        )


def new_verdict(num_envs: int, num_drones: int) -> Verdict:
    """The verdict on environments that have not begun."""
    shape = (num_envs, num_drones)
    return Verdict(
        crashed=np.zeros(shape, dtype=np.bool_),
        succeeded=np.zeros(num_envs, dtype=np.bool_),
        achieved=np.zeros(num_envs),
        terminated=np.zeros(num_envs, dtype=np.bool_),
        truncated=np.zeros(num_envs, dtype=np.bool_),
        last_distance=np.zeros(shape),
        error=np.zeros(shape),
        effort=np.zeros(shape),
    )


@borrowing_kernel
def begin(
    mask: BoolArray,
    radius: float,
    decisions: IntArray,
    time: FloatArray,
    running: BoolArray,
    mission: Mission,
    record: Record,
    verdict: Verdict,
) -> None:
    """Begin to judge the environments of the mask, whose missions have just been placed.

    Args:
        mask: (E,) which begin.
        radius: how near a drone must be to its goal to be there, m.
        decisions: (E,) of this episode, set to 0.
        time: (E,) s, set to 0.
        running: (E,) set.
        mission: enters its first stage.
        record: begins anew; who starts at the goal has arrived.
        verdict: begins anew.
    """
    for e in range(mask.shape[0]):
        if not mask[e]:
            continue
        decisions[e], time[e], running[e] = 0, 0.0, True
        begin_mission(e, mission)
        clear_record(e, record)
        verdict.succeeded[e] = verdict.terminated[e] = verdict.truncated[e] = False
        verdict.achieved[e] = 0.0
        for i in range(mission.distance.shape[1]):
            if mission.distance[e, i] < radius:
                record.arrival[e, i] = 0.0
            verdict.crashed[e, i] = False
            verdict.last_distance[e, i] = verdict.error[e, i] = verdict.effort[e, i] = 0.0


@borrowing_kernel
def tick(flown: BoolArray, rate: int, decisions: IntArray, time: FloatArray) -> None:
    """Count the decision of every environment that flew, and tell the time.

    Args:
        flown: (E,) which did.
        rate: decisions a second.
        decisions: (E,) of this episode, changed in place.
        time: (E,) s, written.
    """
    for e in range(flown.shape[0]):
        if flown[e]:
            decisions[e] += 1
        time[e] = decisions[e] / rate


@borrowing_kernel
def achieve(
    e: int, time: float, rules: Rules, mission: Mission, record: Record, verdict: Verdict
) -> None:
    """Decide what environment `e`, which has not crashed, has achieved in this decision."""
    if rules.tracks:
        worst = 0.0
        for i in range(mission.distance.shape[1]):
            worst = max(worst, record.worst_error[e, i])
        done = time >= rules.horizon_s - _ROUNDING and worst < rules.radius
        done &= record.scored[e] > 0
    else:
        since = 0.0
        for i in range(mission.distance.shape[1]):
            since = max(since, record.arrival[e, i])
        done = time - since >= rules.hold_s - _ROUNDING
    if done and not mission.held[e]:
        stages = mission.goals.shape[1]
        mission.held[e] = True
        mission.reached[e] += 1
        verdict.achieved[e] = 1.0 / stages
        verdict.succeeded[e] = mission.reached[e] == stages


@borrowing_kernel
def enter_stage(
    e: int, time: float, position: FloatArray, rules: Rules, mission: Mission, record: Record
) -> None:
    """Begin the stage of environment `e` that is due, if it is another than the present one."""
    stage = stage_at(time, rules.stage_s, mission.goals.shape[1])
    if stage == mission.stage[e]:
        return
    mission.stage[e], mission.held[e] = stage, False
    for i in range(position.shape[1]):
        square = 0.0
        for k in range(3):
            mission.goal[e, i, k] = mission.goals[e, stage, i, k]
            square += (position[e, i, k] - mission.goal[e, i, k]) ** 2
        mission.distance[e, i] = np.sqrt(square)
        near = mission.distance[e, i] < rules.radius
        record.arrival[e, i] = time if near else np.inf


@borrowing_kernel
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
        verdict.achieved[e] = 0.0
        if not running[e]:
            continue
        for i in range(drones):
            verdict.last_distance[e, i] = mission.distance[e, i]
            if rules.bounded:
                square = 0.0
                for k in range(width):
                    square += actions[e, i, k] * actions[e, i, k]
                verdict.effort[e, i] = square / width
        if rules.tracks:
            for i in range(drones):
                for k in range(3):
                    mission.goal[e, i, k] = reference[e, i, k]
        measure(
            e,
            position,
            reference,
            contacts,
            mission,
            time,
            rules.radius,
            rules.settle_s,
            record,
            verdict.error[e],
        )
        crashed = False
        for i in range(drones):
            touched = contacts.drone[e, i] != NO_DRONE or contacts.obstacle[e, i] != NO_OBSTACLE
            touched |= contacts.floor[e, i] or contacts.wall[e, i]
            verdict.crashed[e, i] |= touched or contacts.tumbling[e, i]
            crashed |= verdict.crashed[e, i]
        if not crashed:
            achieve(e, time[e], rules, mission, record, verdict)
        over = crashed or (rules.end_on_success and verdict.succeeded[e] and not rules.tracks)
        verdict.terminated[e] = over
        verdict.truncated[e] = not over and time[e] >= rules.horizon_s - _ROUNDING
        running[e] = not (over or verdict.truncated[e])
        if running[e]:
            enter_stage(e, time[e], position, rules, mission, record)

"""A drone's side: it flies what it has accepted, says what that is, and answers."""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.mlr_dmpc.codec import Codec
from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.messages import DroneState, Kind, UnitMessage
from swarm_envs.baselines.mlr_dmpc.network import Inbox
from swarm_envs.baselines.mlr_dmpc.samples import is_at_rest, state_at
from swarm_envs.baselines.mlr_dmpc.trajectory import NOBODY, Identity, Trajectory
from swarm_envs.baselines.mlr_dmpc.views import ViewId
from swarm_envs.state import FloatArray

_CONTINUOUS = 1e-5
"""By how much the first state of a plan may differ from the reference, SI."""
_REPORTED_ROUNDS = 30
_LOST_M, _LOST_SPEED = 0.5, 10.0


class Drone:
    """One drone.

    Args:
        index: i.
        start: what it flies at first, a hover.
        lock: the view at deployment.
        config: parameters.
        codec: rounds what 16 bit carry.
        airborne: whether it is in the air, or joins once a plan for it is accepted.
    """

    def __init__(
        self,
        index: int,
        start: Trajectory,
        lock: ViewId,
        config: MlrDmpcConfig,
        codec: Codec,
        airborne: bool = True,
    ) -> None:
        self.index, self.flying, self.lock = index, start, lock
        self.airborne = airborne
        """Whether it is in the air."""
        self.gone = False
        """Whether it has left the air."""
        self._config, self._codec = config, codec
        self._gifts: dict[tuple[int, int], tuple[int, ...]] = {}
        self._gave_up = -(10**6)

    def leave(self) -> None:
        """Leave the air. The others avoid it until they hear that it has."""
        self.gone, self.airborne = True, False

    def state(self, round_: int, target: FloatArray) -> DroneState:
        """Its message of a round.

        Args:
            round_: k.
            target: (3,) as messages carry it, m.
        """
        kinematics = state_at(self.flying, round_, self._config)
        if is_at_rest(self.flying, round_, self._config):
            kinematics = kinematics[:1].astype(np.float32).astype(np.float64)
        else:
            kinematics = self._codec.carried(kinematics)
        return DroneState(
            self.index,
            round_,
            self.flying.identity,
            self.lock,
            target,
            kinematics,
            joining=not self.airborne and not self.gone,
            gone=self.gone,
            reinitialised=round_ - self._gave_up < _REPORTED_ROUNDS,
        )

    def answers(self, round_: int) -> dict[int, UnitMessage]:
        """Its trajectory, in the slots that it was given, by slot."""
        slots = [unit for unit, r in self._gifts if r == round_]
        return {
            unit: UnitMessage(
                Kind.ANSWER,
                round_,
                unit,
                self.lock,
                self.index,
                self.flying,
                donations=self._gifts[unit, round_],
            )
            for unit in slots
        }

    def accepts(self, message: UnitMessage) -> bool:
        """Whether it would fly a plan, if it heard nothing else in that round."""
        if message.kind is not Kind.PLAN or message.drone != self.index or self.gone:
            return False
        plan = message.trajectory
        assert plan is not None
        if message.view < self.lock or plan.identity.start_round != message.round + 1:
            return False
        here = state_at(self.flying, message.round + 1, self._config)
        return bool(np.abs(plan.state - here).max() <= _CONTINUOUS)

    def receive(self, inbox: Inbox[UnitMessage]) -> Trajectory | None:
        """Take in a round's messages; the plan that it accepts, flown from the next round on."""
        accepted = None
        self._gifts = {key: one for key, one in self._gifts.items() if key[1] > inbox.round}
        said = [m for m in inbox.slots.values() if m.kind is not Kind.ANSWER]
        self.lock = max([self.lock, *(message.view for message in said)])
        for message in said:
            for ahead, drone in enumerate(message.donations, start=1):
                if drone == self.index:
                    rest = message.donations[ahead:]
                    self._gifts[message.unit, inbox.round + ahead] = rest
            if message.view == self.lock and self.accepts(message):
                accepted = message.trajectory
        if self.gone:
            return None
        if accepted is not None:
            self.flying, self.airborne = accepted, True
            self._gave_up = -(10**6)
        return accepted

    def give_up(self, measured: FloatArray, round_: int) -> bool:
        """Rest where it is measured to be, if that is far off its reference; whether it did.

        Args:
            measured: (2, 3) position and velocity at the start of a round, m and m/s.
            round_: the round that begins.
        """
        off = np.linalg.norm(measured - state_at(self.flying, round_, self._config)[:2], axis=1)
        if off[0] <= _LOST_M and off[1] <= _LOST_SPEED:
            return False
        state = np.zeros((3, 3))
        state[0] = measured[0]
        jerk = np.zeros_like(self.flying.jerk)
        identity = Identity(round_, NOBODY)
        self.flying = Trajectory(identity, state, jerk, self._config.input_sampling_s)
        self._gave_up = round_
        return True

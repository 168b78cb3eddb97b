"""The truth as data: what `swarm_envs.envs.view.View` says, copied for the process of a work."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from swarm_envs.commands.grading.messages import Array
from swarm_envs.envs.view import View
from swarm_envs.physics.contact import Contacts
from swarm_envs.state import FloatArray, Setpoint, SwarmState
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import Team, parse_team, team_string

_GROUPS = (SwarmState, Setpoint, Contacts)


def pack_view(view: View) -> tuple[dict[str, Any], list[Array]]:
    """What a view says now, as header and arrays of a message."""
    header = {
        "team": team_string(view.team),
        "time": view.time,
        "horizon_s": view.horizon_s,
        "stage_s": view.stage_s,
        "reference_moves": view.reference_moves,
    }
    return header, [*view.state, *view.setpoint, *view.contacts, view.goals, view.oracle_force]


class ViewCopy:
    """What a view said when it was copied. As `swarm_envs.envs.view.View`, without obstacles.

    Args:
        header: of `pack_view`.
        arrays: likewise.
        reference: asks the grader where the drones should be at a time, s.
    """

    def __init__(
        self,
        header: Mapping[str, Any],
        arrays: Sequence[Array],
        reference: Callable[[float], Reference],
    ) -> None:
        rest = list(arrays)
        groups = [kind(*(rest.pop(0) for _ in kind._fields)) for kind in _GROUPS]
        self.team: Team = parse_team(header["team"])
        self.time: float = header["time"]
        self.horizon_s: float = header["horizon_s"]
        self.stage_s: float = header["stage_s"]
        self.reference_moves: bool = header["reference_moves"]
        self.obstacles = ()
        self.state, self.setpoint, self.contacts = groups
        self.goals: FloatArray = rest[0]
        self.oracle_force: FloatArray = rest[1]
        self.reference = reference

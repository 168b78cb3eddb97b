"""What is mutated, and the tests that should notice: quick ones, kernels interpreted."""

from __future__ import annotations

from typing import NamedTuple

_RIGID_BODY = ("tests/physics/test_rigid_body.py",)
_CONTACT = (
    *("tests/physics/test_contact.py", "tests/tasks/test_obstacles.py"),
    *("-k", "not bullet and (test_contact or name_the or nearest_points or many_points)"),
)
_MOTORS = ("tests/test_motors.py",)
_TRACKING = (
    *(
        "tests/control/test_tracking.py",
        "tests/control/test_mixer.py",
        "-k",
        "not adaptive or 0.03 and Observer",
    ),
)
_TRACKER = ("tests/baselines/mlr_dmpc/test_tracker.py",)
_PATHS = ("tests/baselines/rth3d/test_validation.py", "-k", "ring or broken or follow or obstacles")
_CHECKS = ("tests/baselines/mlr_dmpc/test_checks.py",)
_VERIFY = ("tests/baselines/neural_swarm/planner/test_verify.py",)


class Group(NamedTuple):
    """Files that belong together."""

    name: str
    modules: dict[str, tuple[str, ...]]  # by path of a file: arguments of pytest that run its tests


_PHYSICS = {
    "swarm_envs/physics/rigid_body.py": _RIGID_BODY,
    "swarm_envs/physics/contact.py": _CONTACT,
    "swarm_envs/motors.py": _MOTORS,
}
_TRACKERS = {
    "swarm_envs/control/loop.py": _TRACKING,
    "swarm_envs/control/tracking.py": _TRACKING,
    "baselines/mlr_dmpc/information_tracker.py": _TRACKER,
}
_VALIDATORS = {
    "baselines/rth3d/grid_validation.py": _PATHS,
    "baselines/mlr_dmpc/input_checks.py": _CHECKS,
    "baselines/neural_swarm/planner/verify.py": _VERIFY,
}
GROUPS = (
    Group("physics", _PHYSICS),
    Group("trackers", _TRACKERS),
    Group("validators", _VALIDATORS),
)

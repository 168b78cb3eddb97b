"""The state of the simulation: every quantity is declared once, as one line of a table.

`DRONE` has a row for each quantity of a drone, `ENVIRONMENT` for each quantity of an environment,
`SETTINGS` for what stays the same while they fly. From these tables follow the memory
(`new_world`), the views that users see (`world.drones["position"]` is an (E, N, 3) array), the
values at a reset, snapshots (copies of the arrays), and the tables of docs/architecture.md.

Everything of a drone is float64, flags included: the memory of the drones is then also one plain
array (E, N, columns), of which kernels copy ranges of columns.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["SENSED_TYPE", "Field", "Records", "World", "clear_environments"]

Records = npt.NDArray[np.void]
"""An array of records, whose fields are read by name."""
Record: TypeAlias = Any
"""One of them: kernels read its fields as attributes, of which type checkers know nothing."""


class Field(NamedTuple):
    """One quantity of a table."""

    name: str
    """Name of the field."""
    shape: tuple[int, ...]
    """Shape of the quantity of one drone or environment; () for a number."""
    unit: str
    """Unit; empty if it has none."""
    reset: float | None
    """Value when an episode begins; None if the reset computes it, or if it stays."""
    meaning: str
    """What it is, in one sentence."""
    kind: Any = np.float64
    """Type of its numbers."""


_BODY = (
    Field("position", (3,), "m", None, "Position of the centre of mass, world frame."),
    Field("quaternion", (4,), "", None, "Attitude, body to world, (x, y, z, w), of unit length."),
    Field("velocity", (3,), "m/s", None, "Velocity, world frame."),
    Field("angular_velocity", (3,), "rad/s", None, "Angular velocity, world frame."),
    Field("rotor_thrust", (4,), "N", None, "Thrust that each rotor gives now."),
    Field("battery", (), "", None, "Charge left, from 1 (full) to 0 (empty)."),
    Field("rotor_limit", (), "N", None, "Largest thrust of one rotor at this charge."),
    Field("commands", (4,), "N", None, "Commanded thrust of each rotor."),
    Field("force", (3,), "N", 0.0, "Interaction force, as last evaluated, world frame."),
    Field("outside", (), "", 0.0, "1 if that force is an extrapolation past what was measured."),
)
"""What every physics step reads and writes."""

_CONTACT = (
    Field("touched_drone", (), "", -1.0, "Drone touched in this decision (the nearest), or -1."),
    Field("touched_obstacle", (), "", -1.0, "Obstacle touched in this decision, or -1."),
    Field("touched_floor", (), "", 0.0, "1 if the floor was touched in this decision."),
    Field("touched_wall", (), "", 0.0, "1 if a wall or the ceiling was touched in this decision."),
    Field("tumbling", (), "", 0.0, "1 if the drone turned faster than 150 rad/s."),
    Field("separation", (), "m", np.inf, "Smallest distance to another drone in this decision."),
    Field("clearance", (), "", np.inf, "The same over the sum of radii: below 1 is a collision."),
    Field("obstacle_clearance", (), "", np.inf, "Distance to an obstacle over the radius."),
)
"""What a decision has touched: physics steps add to it."""

_METRICS = (
    Field("worst_force", (), "N", 0.0, "Largest interaction force of the episode."),
    Field("energy", (), "J", 0.0, "Ideal induced energy of the rotors in the episode."),
    Field("outside_steps", (), "", 0.0, "Physics steps with an extrapolated force."),
    Field("steps", (), "", 0.0, "Physics steps of the episode."),
    Field("over_bound", (), "", 0.0, "Physics steps with a vertical force above the bound."),
)
"""What an episode adds up to: physics steps add to it."""

_CONTROLLER = (
    Field("setpoint_position", (3,), "m", None, "Set-point of the tracking loop."),
    Field("setpoint_velocity", (3,), "m/s", 0.0, "Its derivative."),
    Field("setpoint_acceleration", (3,), "m/s^2", 0.0, "Its second derivative."),
    Field("setpoint_yaw", (), "rad", 0.0, "Turn about the thrust axis, from the world x axis."),
    Field("velocity_integral", (3,), "m", 0.0, "Integral of the velocity error, world frame."),
    Field("rate_integral", (3,), "rad", 0.0, "Integral of the body-rate error, body frame."),
    Field("desired_thrust", (), "N", 0.0, "Desired thrust T_d of the last step."),
    Field("thrust_rate", (), "N/s", 0.0, "Low-passed derivative of the desired thrust."),
    Field("rate_error", (3,), "rad/s", 0.0, "Body-rate error of the last step."),
    Field("rate_error_rate", (3,), "rad/s^2", 0.0, "Its low-passed derivative."),
    Field("desired_attitude", (4,), "", 0.0, "Desired tilt of the last step, before the yaw."),
    Field("desired_rate", (3,), "rad/s", 0.0, "Low-passed angular velocity of the desired tilt."),
    Field("started", (), "", 0.0, "1 once the controller has made a step."),
    Field("feedforward_force", (3,), "N", 0.0, "Interaction force that is compensated."),
)
"""What the tracking loop remembers; rotor commands alone do without it."""

_VEHICLE = (
    Field("mass", (), "kg", None, "Mass."),
    Field("inertia", (3,), "kg m^2", None, "Principal moments of inertia."),
    Field("motor_rate", (), "1/s", None, "Motor rate lambda."),
    Field("max_rotor_thrust", (), "N", None, "Largest thrust of one rotor at a full battery."),
    Field("rotor_offset", (), "m", None, "Distance of each rotor from the body x and y axes."),
    Field("thrust_to_torque", (), "m", None, "Yaw torque per newton of rotor thrust."),
    Field("radius", (), "m", None, "Radius of the collision sphere."),
    Field("nominal_mass", (), "kg", None, "Mass, as the controller knows it."),
    Field("nominal_inertia", (3,), "kg m^2", None, "Moments of inertia, likewise."),
    Field("nominal_motor_rate", (), "1/s", None, "Motor rate, likewise."),
    Field("nominal_max_rotor_thrust", (), "N", None, "Largest rotor thrust, likewise."),
    Field("nominal_motor_decay", (), "", None, "exp(-nominal_motor_rate dt) of a controller step."),
    Field("motor_decay", (), "", None, "exp(-motor_rate dt) of a physics step."),
    Field("thrust_gain", (), "", None, "Force of the rotors over what their thrusts say."),
    Field("energy_scale", (), "J/N^1.5", None, "Induced energy of a rotor in one physics step."),
    Field("force_bound", (), "N", None, "Bound on the vertical force, for metrics."),
    Field("type", (), "", None, "Interaction type in the force model of the environment."),
    Field("feedforward_type", (), "", None, "Interaction type in the model that it compensates."),
    Field(
        "external", (3,), "N", 0.0, "Further force: that given to `step`; in a block also gusts."
    ),
    Field("setpoint_jerk", (3,), "m/s^3", 0.0, "Third derivative of the set-point."),
    Field("setpoint_yaw_rate", (), "rad/s", 0.0, "Derivative of the set-point's yaw."),
    Field("asked", (4,), "N, rad/s", None, "Thrust and body rates that action `ctbr` asks for."),
)
"""What each drone is made of, and what stays as it is in a decision."""

_ADAPTATION = (
    Field("adaptive_force", (3,), "N", 0.0, "Force that adaptation adds to the feed-forward."),
    Field("filtered_residual", (3,), "N", 0.0, "Force that is not explained, low-passed."),
    Field("filtered_residual_rate", (3,), "N/s", 0.0, "Its derivative."),
    Field("adaptive_coefficients", (3, 3), "1, 1/s, m/s^2", 0.0, "Of Neural-Fly, by axis."),
    Field("adaptive_covariance", (3, 6), "", 0.0, "Theirs, by axis: its upper triangle, in rows."),
    Field("nominal_thrust", (), "N", 0.0, "Total thrust by the nominal motors' lag."),
    Field("last_thrust_axis", (3,), "", 0.0, "Direction of thrust one step ago, world frame."),
    Field("last_velocity", (3,), "m/s", 0.0, "Velocity one step ago, world frame."),
    Field("last_feedforward", (3,), "N", 0.0, "Interaction force compensated one step ago."),
)
"""What an adaptive tracking loop remembers as well."""

_HALL_VARIES = (
    Field("residual_process", (3,), "", None, "Random process of unit variance."),
    Field("company", (), "", 0.0, "1 if another drone was in the interaction volume."),
    Field("frame_phase", (), "", None, "Share of a frame's time since the last one arrived."),
    Field("position_error", (3,), "m", 0.0, "Error of the estimated position."),
    Field("velocity_error", (3,), "m/s", 0.0, "Error of the estimated velocity."),
    Field("attitude_error", (3,), "rad", 0.0, "Error of the estimated attitude, world frame."),
    Field("gyro_error", (3,), "rad/s", 0.0, "Error of the measured angular velocity, world frame."),
    Field("interaction_torque", (3,), "N m", 0.0, "Torque of the air, if it has any, body frame."),
)
"""What the world "hall" adds: air that no model knows, and errors of the estimated state; and the
torque of option `interaction_torque`."""

_HALL_STAYS = (
    Field("residual_quiet", (), "N", None, "Random force, its standard deviation without a wake."),
    Field("residual_more", (), "N", None, "What it grows by where the modelled force is large."),
    Field("residual_half", (), "N", None, "Modelled force at which it has grown by half of that."),
    Field("residual_alone", (), "N", None, "Its standard deviation where no drone is near."),
    Field("force_offset", (), "N", None, "Constant vertical force that no model knows."),
)
"""What the hall draws for an episode: physics steps read it."""

_EPISODE = (
    Field("battery_capacity", (), "A s", None, "Charge of a full battery."),
    Field("battery_resistance", (), "1/A", None, "Fall of the voltage with current, over 4.2 V."),
    Field("force_to_pwm", (5,), "", None, "Coefficients psi2 of Table I."),
    Field("pwm_to_max_force", (3,), "", None, "Coefficients psi3 of Table I."),
    Field("wrench", (6,), "N, N m", None, "Force and torque on a Bullet body, body frame."),
    Field("type_code", (3,), "", None, "One-hot code of the vehicle, as it is observed."),
    Field("hover_thrust", (), "N", None, "Thrust of one rotor in hover."),
    Field("charge", (), "", None, "Charge at the start of an episode."),
    Field("start", (3,), "m", None, "Start position."),
    Field("goal", (3,), "m", None, "Goal position of the present stage."),
    Field("orbit", (3, 3), "m", None, "Centre and half axes of the reference's ellipse."),
    Field("orbit_rate", (), "rad/s", None, "Angular rate on it."),
    Field("orbit_phase", (), "rad", None, "Angle at time zero."),
    Field("chased", (), "", None, "Index of the drone that the goal follows; -1 if there is none."),
    Field("reference_position", (3,), "m", None, "Where the drone should be now."),
    Field("reference_velocity", (3,), "m/s", None, "Derivative of the reference."),
    Field("reference_acceleration", (3,), "m/s^2", None, "Its second derivative."),
    Field("reference_jerk", (3,), "m/s^3", None, "Its third derivative."),
    Field("distance", (), "m", None, "Distance to the goal at the last decision."),
    Field("last_distance", (), "m", 0.0, "The same one decision earlier."),
    Field("tracking_error", (), "m", 0.0, "Distance to the reference."),
    Field("effort", (), "", 0.0, "Mean square of the action; 0 where actions are unbounded."),
    Field("scores", (), "", 0.0, "1 if it reached a goal in this decision, where goals go on."),
    Field("crashed", (), "", 0.0, "1 if it collided, left the arena or tumbled in this decision."),
    Field("active", (), "", 1.0, "1 while the drone flies, 0 once its own episode has ended."),
    Field("touching", (), "", 0.0, "Sum of the codes of what was touched in this decision."),
    Field("hurt", (), "", 0.0, "The same of the whole episode; see `swarm_envs.envs.evaluation`."),
    Field("least_separation", (), "m", np.inf, "Smallest distance to another drone so far."),
    Field("least_clearance", (), "", np.inf, "The same over the sum of radii."),
    Field("least_obstacle_clearance", (), "", np.inf, "The same of obstacles, over the radius."),
    Field("worst_error", (), "m", 0.0, "Largest distance to the reference so far."),
    Field("worst_height_error", (), "m", 0.0, "Largest vertical distance to it so far."),
    Field("squared_error", (), "m^2", 0.0, "Sum of the squared distance to the reference."),
    Field("arrival", (), "s", np.inf, "When the drone came to stay at its goal; inf if it is not."),
)
"""What a decision, an episode, or a battery adds: not read in ordinary physics steps."""

DRONE = (
    *_BODY,
    *_CONTACT,
    *_METRICS,
    *_CONTROLLER,
    *_VEHICLE,
    *_ADAPTATION,
    *_HALL_VARIES,
    *_HALL_STAYS,
    *_EPISODE,
)
"""Every quantity of a drone."""

_KEPT = (
    Field("force_scale", (), "", None, "Factor of the interaction force."),
    Field("duration", (), "s", None, "Time of the reference from one stage to the next; 0: rest."),
    Field("gust_key", (), "", None, "Stream of random numbers of the gusts.", np.uint64),
    Field("noise_scale", (), "", None, "Factor of the noise of the observations."),
    Field("noise_key", (), "", None, "Stream of random numbers of the observations.", np.uint64),
    Field("hall_key", (), "", None, "Stream of random numbers of the hall.", np.uint64),
    Field("goal_key", (), "", None, "Stream of random numbers of goals to come.", np.uint64),
)
"""What a task or a randomisation draws for an episode, and a reset leaves."""

_BEGINS = (
    Field("time", (), "s", 0.0, "Time since the episode began."),
    Field("gust", (3,), "m/s^2", 0.0, "Acceleration that gusts give now, world frame."),
    Field("achieved", (), "", 0.0, "Share of the task that was done in this decision."),
    Field("score", (), "", 0.0, "Score so far, of tasks that end at the time limit."),
    Field("age", (), "", 0.0, "Physics steps since the reset.", np.int64),
    Field("decisions", (), "", 0.0, "Decisions of this episode.", np.int64),
    Field("stage", (), "", 0.0, "The present stage.", np.int64),
    Field("reached", (), "", 0.0, "Stages that all who still flew have done.", np.int64),
    Field("unhurt", (), "", 0.0, "Of these, before any drone was hurt.", np.int64),
    Field("goals_reached", (), "", 0.0, "Goals that drones reached, where goals go on.", np.int64),
    Field("scored", (), "", 0.0, "Decisions whose error counts.", np.int64),
    Field("running", (), "", 1.0, "Whether the episode continues.", np.bool_),
    Field("held", (), "", 0.0, "Whether the present stage is done.", np.bool_),
    Field("succeeded", (), "", 0.0, "Whether the task is done.", np.bool_),
    Field("terminated", (), "", 0.0, "Ended by a crash or by success.", np.bool_),
    Field("truncated", (), "", 0.0, "Ended by the time limit.", np.bool_),
)
"""What restarts with each episode."""

ENVIRONMENT = (*_KEPT, *_BEGINS)  # Every quantity of an environment

SETTINGS = (
    Field("level", (), "", None, "Where actions enter: SETPOINTS, RATES or ROTORS.", np.int64),
    Field("hold", (), "", None, "Physics steps over which the force is held.", np.int64),
    Field("compensates", (), "", None, "Whether the controller compensates a force.", np.bool_),
    Field("drains", (), "", None, "Whether batteries empty.", np.bool_),
    Field("gusty", (), "", None, "Whether there are gusts.", np.bool_),
    Field("bounded", (), "", None, "Whether actions lie in [-1, 1].", np.bool_),
    Field("tracks", (), "", None, "Whether the reference is to be kept to.", np.bool_),
    Field("exchanges", (), "", None, "Whether drones may take each other's goals.", np.bool_),
    Field("end_on_success", (), "", None, "Whether success ends the episode.", np.bool_),
    Field("ends_team", (), "", None, "Whether contact ends the episode of the team.", np.bool_),
    Field("bounces", (), "", None, "Whether drones bounce off what they touch.", np.bool_),
    Field("arena", (2, 3), "m", None, "Corners of the walls."),
    Field("gust_kept", (), "", None, "Share of a gust that is left after a physics step."),
    Field("gust_strength", (), "m/s^2", None, "Standard deviation of the gusts."),
    Field("idle_current", (), "A", None, "Current with the rotors at rest."),
    Field("current_per_newton", (), "A/N", None, "Current for a newton of thrust."),
    Field("step", (), "s", None, "Length of a controller step."),
    Field("position_gain", (), "1/s", None, "Lambda of eq. (18)."),
    Field("velocity_gain", (), "1/s", None, "K_v / m of eq. (19)."),
    Field("integral_gain", (), "1/s", None, "Gamma_v of eq. (19)."),
    Field("attitude_tilt", (), "1/s", None, "Lambda_q of eq. (20) for roll and pitch."),
    Field("attitude_yaw", (), "1/s", None, "Lambda_q of eq. (20) for yaw."),
    Field("rate_tilt", (), "1/s", None, "K_omega / J of eq. (21) for roll and pitch."),
    Field("rate_yaw", (), "1/s", None, "K_omega / J of eq. (21) for yaw."),
    Field("rate_integral_tilt", (), "1/s^2", None, "Gamma_omega / J for roll and pitch."),
    Field("rate_integral_yaw", (), "1/s^2", None, "Gamma_omega / J for yaw."),
    Field("velocity_integral_limit", (), "m", None, "Largest integral of the velocity error."),
    Field("rate_integral_limit", (), "rad", None, "Largest integral of the body-rate error."),
    Field("min_vertical_thrust_fraction", (), "", None, "Least vertical force, over the weight."),
    Field("thrust_rate_blend", (), "", None, "Low-pass on the derivative of the thrust."),
    Field("rate_error_blend", (), "", None, "Low-pass on the derivative of the rate error."),
    Field("desired_rate_blend", (), "", None, "Low-pass on the desired body rate."),
    Field("lead", (), "", None, "1 with lag compensation, 0 without."),
    Field("adaptation", (), "", None, "Which adaptation: see swarm_envs.control.config.", np.int64),
    Field("residual_filter", (4,), "1, s, 1/s, 1", None, "Low-pass of the residual, over a step."),
    Field("adaptive_kept", (), "", None, "Share of Neural-Fly's coefficients kept in a step."),
    Field("adaptive_drift", (3,), "", None, "Variance that its coefficients gain in a step."),
    Field("adaptive_noise", (), "m^2/s^4", None, "Variance of the accelerations it learns from."),
    Field("decision_rate", (), "1/s", None, "Decisions a second.", np.int64),
    Field("decision_s", (), "s", None, "Time between decisions."),
    Field("horizon_s", (), "s", None, "Time limit."),
    Field("stage_s", (), "s", None, "Time that each stage lasts; 0 if there is only one."),
    Field("ramp", (), "", None, "Its ramp: see `swarm_envs.tasks.motion.Motion`."),
    Field("success_radius", (), "m", None, "How near a drone must be to its goal or reference."),
    Field("hold_s", (), "s", None, "How long all must stay there."),
    Field("settle_s", (), "s", None, "Errors count from this time on."),
    Field("least_score", (), "", None, "Score of a success at the time limit."),
    Field("goal_reach", (2,), "m", None, "How far the next goal is, at least and at most."),
    Field("noise", (4,), "m, m/s, rad, rad/s", None, "Standard deviations of observations."),
    Field("residual_kept", (), "", None, "Share of the residual that is left after a step."),
    Field("residual_sideways", (), "", None, "Horizontal residual over the vertical one."),
    Field("velocity_walk", (), "m/s", None, "Noise of the estimated velocity in a step."),
    Field("attitude_walk", (), "rad", None, "Noise of the estimated attitude in a step."),
    Field("frames_per_step", (), "", None, "Frames of motion capture in a step."),
    Field("frame_delay", (), "s", None, "Age of a frame when it arrives."),
    Field("frame_loss", (), "", None, "Probability that a frame is lost."),
    Field("frame_noise", (2,), "m, rad", None, "Standard deviations of a frame."),
    Field("frame_gain", (3,), "1, 1/s, 1", None, "Its gain on position, velocity, attitude."),
)
"""What stays the same while environments fly."""

_SCRATCH = (
    Field("yaw_sin", (), "", None, "Sine of half the yaw angle."),
    Field("yaw_cos", (), "", None, "Cosine of half the yaw angle."),
    Field("desired_force", (3,), "N", None, "Force that the position loop asks for."),
    Field("asked_change", (3,), "rad/s^2", None, "Derivative of the body rates asked for."),
    Field("body_rate", (3,), "rad/s", None, "Angular velocity in the body frame."),
    Field("torque", (3,), "N m", None, "Torque of the rate loop, but for its gyroscopic part."),
    Field("residual", (3,), "N", None, "Force that nominal thrust and feed-forward leave over."),
    Field("old_velocity", (3,), "m/s", None, "Velocity one step ago."),
    Field("old_feedforward", (3,), "N", None, "Interaction force compensated one step ago."),
    Field("stream", (), "", None, "Where the stream of random numbers of a drone is.", np.uint64),
    Field("seen_position", (3,), "m", None, "Position as estimated in the hall."),
    Field("seen_quaternion", (4,), "", None, "Attitude, likewise."),
    Field("seen_velocity", (3,), "m/s", None, "Velocity, likewise."),
    Field("seen_angular_velocity", (3,), "rad/s", None, "Angular velocity, likewise."),
)
"""What a block has besides the columns of the drones."""


def record_type(fields: tuple[Field, ...], lanes: int | None = None) -> np.dtype[np.void]:
    """The record of a table; with `lanes`, that of so many drones side by side.

    Its fields are attributes, in kernels that are interpreted too.
    """
    last = () if lanes is None else (lanes,)
    plain = np.dtype([(f.name, f.kind, (*f.shape, *last)) for f in fields], align=True)
    return np.dtype((np.record, plain))


LANES = 8
"""Drones in a block. The same quantity of eight drones fills a row of 64 bytes, which is a register
of AVX-512 and two of AVX2: loops over lanes become vector instructions."""

DRONE_TYPE = record_type(DRONE)  # A drone: one record
SENSED_TYPE = record_type(_BODY)
"""What observations see of a drone where it is not the truth: one record."""
ENVIRONMENT_TYPE = record_type(ENVIRONMENT)  # An environment: one record
SETTINGS_TYPE = record_type(SETTINGS)  # The settings: one record
BLOCK_TYPE = record_type(
    (
        *_BODY,
        *_CONTACT,
        *_METRICS,
        *_CONTROLLER,
        *_VEHICLE,
        *_ADAPTATION,
        *_HALL_VARIES,
        *_HALL_STAYS,
        *_SCRATCH,
    ),
    LANES,
)
"""What a physics step knows of `LANES` drones."""


def _columns(fields: tuple[Field, ...]) -> int:
    return record_type(fields).itemsize // 8


BODY_END = _columns((*_BODY, *_CONTACT, *_METRICS))
"""Columns of a drone before this one are read and written by every physics step."""
CONTROLLER_END = BODY_END + _columns(_CONTROLLER)
"""Columns from `BODY_END` to this one belong to the tracking loop."""
VEHICLE_END = CONTROLLER_END + _columns(_VEHICLE)
"""Columns from `CONTROLLER_END` to this one are never written back by physics steps."""
ADAPTATION_END = VEHICLE_END + _columns(_ADAPTATION)
"""Columns from `VEHICLE_END` to this one belong to the adaptation of the tracking loop."""
_HALL_CHANGED = ADAPTATION_END + _columns(_HALL_VARIES)
HALL_ENDS = (_HALL_CHANGED, _HALL_CHANGED + _columns(_HALL_STAYS))
"""Columns from `ADAPTATION_END` to the first are what changes in the world "hall"; those from there
to the second are never written back by physics steps."""
ACTIVE = int(dict(DRONE_TYPE.fields or ())["active"][1]) // 8
"""Column that says whether a drone still flies."""


LINE = 64  # Bytes of a cache line


def aligned(count: int, row: np.dtype[np.void]) -> Records:
    """Zeros that begin at a cache line, as vector loads and stores want it."""
    memory = np.zeros(count * row.itemsize + LINE, np.uint8)
    start = -memory.ctypes.data % LINE
    return memory[start : start + count * row.itemsize].view(np.dtype((np.record, row)))


class World(NamedTuple):
    """All that changes while E environments of N drones fly."""

    drones: Records
    """(E, N) records of `DRONE`."""
    environments: Records
    """(E,) records of `ENVIRONMENT`."""
    goals: npt.NDArray[np.float64]
    """(E, S, N, 3) goal positions of each stage, m, world frame."""

    def copy(self) -> World:
        """The same in memory of its own."""
        return World(self.drones.copy(), self.environments.copy(), self.goals.copy())

    @property
    def columns(self) -> npt.NDArray[np.float64]:
        """(E, N, columns) the memory of the drones as plain numbers."""
        return as_columns(self.drones)


def as_columns(drones: Records) -> npt.NDArray[np.float64]:
    """The memory of records (E, N) as plain numbers (E, N, columns)."""
    return drones.view(np.float64).reshape(*drones.shape, -1)


def new_world(num_envs: int, num_drones: int, num_stages: int = 1) -> World:
    """Memory of environments that have not begun: zeros."""
    return World(
        np.zeros((num_envs, num_drones), DRONE_TYPE),
        np.zeros(num_envs, ENVIRONMENT_TYPE),
        np.zeros((num_envs, num_stages, num_drones, 3)),
    )


def _reset_columns(
    fields: tuple[Field, ...],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Columns of a drone that a reset of these fields sets, and their values."""
    placed = (DRONE_TYPE.fields or {}).items()
    places = {name: place[1] // 8 for name, place in placed}
    found = [
        (column, field.reset)
        for field in fields
        if field.reset is not None
        for column in range(places[field.name], places[field.name] + math.prod(field.shape))
    ]
    columns, values = zip(*found, strict=True)
    return np.array(columns), np.array(values)


RESET_COLUMNS, RESET_VALUES = _reset_columns(DRONE)
"""Columns of a drone that a reset sets, and their values."""
CONTACT_COLUMNS, CONTACT_VALUES = _reset_columns(_CONTACT)
"""The same of contacts, which restart at every decision."""
_BEGUN = np.zeros(1, ENVIRONMENT_TYPE)
for _field in _BEGINS:
    _BEGUN[_field.name] = _field.reset
_FIRST_RESET = dict(ENVIRONMENT_TYPE.fields or ())[_BEGINS[0].name][1]
_ENVIRONMENT_SIZE = ENVIRONMENT_TYPE.itemsize
_RESET_PART = np.dtype(
    {
        "names": ["begun"],
        "formats": [np.dtype((np.void, _ENVIRONMENT_SIZE - _FIRST_RESET))],
        "offsets": [_FIRST_RESET],
        "itemsize": _ENVIRONMENT_SIZE,
    }
)
"""An environment whose quantities that restart are one lump of memory, to be set at once."""


def clear_environments(environments: Records, where: npt.NDArray[np.int64]) -> None:
    """Give the quantities of these environments (M,) their values at a reset."""
    environments.view(_RESET_PART)["begun"][where] = _BEGUN.view(_RESET_PART)["begun"]

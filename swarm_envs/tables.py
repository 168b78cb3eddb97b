"""The state of the simulation, declared in tables with one line for each quantity.

`DRONE` has the quantities of a drone, `ENVIRONMENT` those of an environment, and `SETTINGS` those
that are constant. The tables define the memory (`new_world`), the views of users
(`world.drones["position"]` is an (E, N, 3) array), the values at a reset, snapshots (copies of the
arrays), and the tables of docs/architecture.md.

All quantities of a drone are float64, also flags: the memory of the drones is thereby also an array
(E, N, columns), of which kernels copy ranges of columns.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["SENSED_TYPE", "Field", "Records", "World", "clear_environments"]

Records = npt.NDArray[np.void]
"""An array of records, whose fields are accessed by name."""
Record: TypeAlias = Any
"""A record; its fields are attributes in kernels, which type checkers cannot check."""


class Field(NamedTuple):
    """A quantity of a table."""

    name: str
    """Name of the field."""
    shape: tuple[int, ...]
    """Shape for one drone or environment; () for a number."""
    unit: str
    """Unit; empty if it has none."""
    reset: float | None
    """Value at a reset; None if the reset computes it or does not change it."""
    meaning: str
    """Description, in one sentence."""
    kind: Any = np.float64
    """Type of the numbers."""


_BODY = (
    Field("position", (3,), "m", None, "Position of the center of mass, world frame."),
    Field("quaternion", (4,), "", None, "Attitude, body to world, (x, y, z, w), of unit length."),
    Field("velocity", (3,), "m/s", None, "Velocity, world frame."),
    Field("angular_velocity", (3,), "rad/s", None, "Angular velocity, world frame."),
    Field("rotor_thrust", (4,), "N", None, "Present thrust of each rotor."),
    Field("battery", (), "", None, "Charge, from 1 (full) to 0 (empty)."),
    Field("rotor_limit", (), "N", None, "Largest thrust of one rotor at this charge."),
    Field("commands", (4,), "N", None, "Commanded thrust of each rotor."),
    Field("force", (3,), "N", 0.0, "Interaction force, as last evaluated, world frame."),
    Field("outside", (), "", 0.0, "1 if the force is extrapolated beyond the measured range."),
)
"""Quantities that every physics step reads and writes."""

_CONTACT = (
    Field("touched_drone", (), "", -1.0, "Drone touched in this decision (the nearest), or -1."),
    Field("touched_obstacle", (), "", -1.0, "Obstacle touched in this decision, or -1."),
    Field("touched_floor", (), "", 0.0, "1 if the floor was touched in this decision."),
    Field("touched_wall", (), "", 0.0, "1 if a wall or the ceiling was touched in this decision."),
    Field("tumbling", (), "", 0.0, "1 if the drone turned faster than 150 rad/s."),
    Field("separation", (), "m", np.inf, "Smallest distance to another drone in this decision."),
    Field(
        "clearance", (), "", np.inf, "Separation over the sum of radii; below 1 for a collision."
    ),
    Field("obstacle_clearance", (), "", np.inf, "Distance to an obstacle over the radius."),
)
"""Contacts of a decision, which physics steps update."""

_METRICS = (
    Field("worst_force", (), "N", 0.0, "Largest interaction force of the episode."),
    Field("energy", (), "J", 0.0, "Ideal induced energy of the rotors in the episode."),
    Field("outside_steps", (), "", 0.0, "Physics steps with an extrapolated force."),
    Field("steps", (), "", 0.0, "Physics steps of the episode."),
    Field("over_bound", (), "", 0.0, "Physics steps with a vertical force above the bound."),
)
"""Metrics of an episode, which physics steps update."""

_CONTROLLER = (
    Field("setpoint_position", (3,), "m", None, "Position of the set-point."),
    Field("setpoint_velocity", (3,), "m/s", 0.0, "Velocity of the set-point."),
    Field("setpoint_acceleration", (3,), "m/s^2", 0.0, "Acceleration of the set-point."),
    Field("setpoint_yaw", (), "rad", 0.0, "Yaw of the set-point, from the world x axis."),
    Field("velocity_integral", (3,), "m", 0.0, "Integral of the velocity error, world frame."),
    Field("rate_integral", (3,), "rad", 0.0, "Integral of the body-rate error, body frame."),
    Field("desired_thrust", (), "N", 0.0, "Desired thrust T_d of the last step."),
    Field("thrust_rate", (), "N/s", 0.0, "Low-passed derivative of the desired thrust."),
    Field("rate_error", (3,), "rad/s", 0.0, "Body-rate error of the last step."),
    Field("rate_error_rate", (3,), "rad/s^2", 0.0, "Low-passed derivative of the body-rate error."),
    Field("desired_attitude", (4,), "", 0.0, "Desired tilt of the last step, without the yaw."),
    Field("desired_rate", (3,), "rad/s", 0.0, "Low-passed angular velocity of the desired tilt."),
    Field("started", (), "", 0.0, "1 after the controller's first step."),
    Field("feedforward_force", (3,), "N", 0.0, "Interaction force that is compensated."),
)
"""State of the tracking controller; not used if actions are rotor commands."""

_VEHICLE = (
    Field("mass", (), "kg", None, "Mass."),
    Field("inertia", (3,), "kg m^2", None, "Principal moments of inertia."),
    Field("motor_rate", (), "1/s", None, "Motor rate lambda."),
    Field("max_rotor_thrust", (), "N", None, "Largest thrust of one rotor at a full battery."),
    Field("rotor_offset", (), "m", None, "Distance of each rotor from the body x and y axes."),
    Field("thrust_to_torque", (), "m", None, "Yaw torque per newton of rotor thrust."),
    Field("radius", (), "m", None, "Radius of the collision sphere."),
    Field("nominal_mass", (), "kg", None, "Nominal mass, which the controller uses."),
    Field("nominal_inertia", (3,), "kg m^2", None, "Nominal moments of inertia."),
    Field("nominal_motor_rate", (), "1/s", None, "Nominal motor rate."),
    Field("nominal_max_rotor_thrust", (), "N", None, "Nominal largest rotor thrust."),
    Field("nominal_motor_decay", (), "", None, "exp(-nominal_motor_rate dt) of a controller step."),
    Field("motor_decay", (), "", None, "exp(-motor_rate dt) of a physics step."),
    Field("thrust_gain", (), "", None, "Factor from `rotor_thrust` to the rotors' force."),
    Field("energy_scale", (), "J/N^1.5", None, "Induced energy of a rotor in one physics step."),
    Field("force_bound", (), "N", None, "Bound on the vertical force, for metrics."),
    Field("type", (), "", None, "Interaction type in the force model of the environment."),
    Field("feedforward_type", (), "", None, "Interaction type in the compensated force model."),
    Field("external", (3,), "N", 0.0, "External force of `step`; in a block also that of gusts."),
    Field("setpoint_jerk", (3,), "m/s^3", 0.0, "Third derivative of the set-point."),
    Field("setpoint_yaw_rate", (), "rad/s", 0.0, "Derivative of the set-point's yaw."),
    Field("ctbr", (4,), "N, rad/s", None, "Commanded thrust and body rates."),
)
"""Parameters of a drone, and quantities that are constant in a decision."""

_ADAPTATION = (
    Field("adaptive_force", (3,), "N", 0.0, "Force that adaptation adds to the feed-forward."),
    Field("filtered_residual", (3,), "N", 0.0, "Low-passed residual force."),
    Field("filtered_residual_rate", (3,), "N/s", 0.0, "Derivative of the low-passed residual."),
    Field("adaptive_coefficients", (3, 3), "1, 1/s, m/s^2", 0.0, "Coefficients of Neural-Fly."),
    Field("adaptive_covariance", (3, 6), "", 0.0, "Upper triangles of their covariances, by axis."),
    Field("nominal_thrust", (), "N", 0.0, "Total thrust with the nominal motor lag."),
    Field("last_thrust_axis", (3,), "", 0.0, "Direction of thrust one step ago, world frame."),
    Field("last_velocity", (3,), "m/s", 0.0, "Velocity one step ago, world frame."),
    Field("last_feedforward", (3,), "N", 0.0, "Interaction force compensated one step ago."),
)
"""Further state of a tracking controller with adaptation."""

_HALL_VARIES = (
    Field("residual_process", (3,), "", None, "Random process of unit variance."),
    Field("has_neighbor", (), "", 0.0, "1 if another drone was in the interaction volume."),
    Field("frame_phase", (), "", None, "Time since the last frame over the time between frames."),
    Field("position_error", (3,), "m", 0.0, "Error of the estimated position."),
    Field("velocity_error", (3,), "m/s", 0.0, "Error of the estimated velocity."),
    Field("attitude_error", (3,), "rad", 0.0, "Error of the estimated attitude, world frame."),
    Field("gyro_error", (3,), "rad/s", 0.0, "Error of the measured angular velocity, world frame."),
    Field("interaction_torque", (3,), "N m", 0.0, "Aerodynamic torque, body frame."),
)
"""State of the world "hall": random force, and errors of the estimated state; and the torque of
option `interaction_torque`."""

_HALL_STAYS = (
    Field("residual_quiet", (), "N", None, "Standard deviation of the random force, no wake."),
    Field("residual_more", (), "N", None, "Increase of it in a large modeled force."),
    Field("residual_half", (), "N", None, "Modeled force with half of this increase."),
    Field(
        "residual_alone", (), "N", None, "Standard deviation of the random force, no drone near."
    ),
    Field("force_offset", (), "N", None, "Constant vertical force that no model contains."),
)
"""Random parameters of the hall, constant in an episode."""

_EPISODE = (
    Field("battery_capacity", (), "A s", None, "Charge of a full battery."),
    Field("battery_resistance", (), "1/A", None, "Internal resistance over 4.2 V."),
    Field("force_to_pwm", (5,), "", None, "Coefficients psi2 of Table I."),
    Field("pwm_to_max_force", (3,), "", None, "Coefficients psi3 of Table I."),
    Field("wrench", (6,), "N, N m", None, "Force and torque on a Bullet body, body frame."),
    Field("type_code", (3,), "", None, "One-hot code of the vehicle type."),
    Field("hover_thrust", (), "N", None, "Thrust of one rotor in hover."),
    Field("charge", (), "", None, "Charge at the start of an episode."),
    Field("start", (3,), "m", None, "Start position."),
    Field("goal", (3,), "m", None, "Goal position of the present stage."),
    Field("orbit", (3, 3), "m", None, "Center and half axes of the reference's ellipse."),
    Field("orbit_rate", (), "rad/s", None, "Angular rate on the ellipse."),
    Field("orbit_phase", (), "rad", None, "Angle on the ellipse at time zero."),
    Field("chased", (), "", None, "Index of the drone that the goal follows, or -1."),
    Field("reference_position", (3,), "m", None, "Position of the reference."),
    Field("reference_velocity", (3,), "m/s", None, "Velocity of the reference."),
    Field("reference_acceleration", (3,), "m/s^2", None, "Acceleration of the reference."),
    Field("reference_jerk", (3,), "m/s^3", None, "Jerk of the reference."),
    Field("distance", (), "m", None, "Distance to the goal at the last decision."),
    Field("last_distance", (), "m", 0.0, "Distance to the goal one decision earlier."),
    Field("tracking_error", (), "m", 0.0, "Distance to the reference."),
    Field("effort", (), "", 0.0, "Mean square of the action; 0 for unbounded actions."),
    Field(
        "scores", (), "", 0.0, "1 if the drone reached one of successive goals in this decision."
    ),
    Field("crashed", (), "", 0.0, "1 if it collided, left the arena or tumbled in this decision."),
    Field("active", (), "", 1.0, "1 until the drone's episode ends, then 0."),
    Field("touching", (), "", 0.0, "Sum of the codes of contacts in this decision."),
    Field("incidents", (), "", 0.0, "Codes of all contacts, as in `swarm_envs.envs.evaluation`."),
    Field("least_separation", (), "m", np.inf, "Smallest distance to another drone so far."),
    Field("least_clearance", (), "", np.inf, "Smallest clearance to another drone so far."),
    Field("least_obstacle_clearance", (), "", np.inf, "Smallest clearance to an obstacle so far."),
    Field("worst_error", (), "m", 0.0, "Largest distance to the reference so far."),
    Field("worst_height_error", (), "m", 0.0, "Largest vertical distance to it so far."),
    Field("squared_error", (), "m^2", 0.0, "Sum of the squared distances to the reference."),
    Field(
        "arrival", (), "s", np.inf, "Time from which the drone has stayed at its goal; inf if away."
    ),
)
"""Quantities of decisions, episodes and batteries, which few physics steps read."""

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
"""All quantities of a drone."""

_KEPT = (
    Field("force_scale", (), "", None, "Factor of the interaction force."),
    Field("duration", (), "s", None, "Time of the reference from one stage to the next; 0: rest."),
    Field("gust_key", (), "", None, "Key of the random numbers of gusts.", np.uint64),
    Field("noise_scale", (), "", None, "Factor of the noise of observations."),
    Field("noise_key", (), "", None, "Key of the random numbers of observations.", np.uint64),
    Field("hall_key", (), "", None, "Key of the random numbers of the hall.", np.uint64),
    Field("goal_key", (), "", None, "Key of the random numbers of successive goals.", np.uint64),
)
"""Quantities that the task or the domain randomization samples for an episode."""

_BEGINS = (
    Field("time", (), "s", 0.0, "Time since the episode began."),
    Field("gust", (3,), "m/s^2", 0.0, "Present acceleration by gusts, world frame."),
    Field("achieved", (), "", 0.0, "Share of the task that was done in this decision."),
    Field("score", (), "", 0.0, "Score so far, in tasks with a score."),
    Field("age", (), "", 0.0, "Physics steps since the reset.", np.int64),
    Field("decisions", (), "", 0.0, "Decisions of this episode.", np.int64),
    Field("stage", (), "", 0.0, "The present stage.", np.int64),
    Field("reached", (), "", 0.0, "Stages that all active drones have done.", np.int64),
    Field("crash_free_stages", (), "", 0.0, "Stages that were done before any crash.", np.int64),
    Field("goals_reached", (), "", 0.0, "Successive goals that drones have reached.", np.int64),
    Field("scored", (), "", 0.0, "Decisions whose errors count.", np.int64),
    Field("running", (), "", 1.0, "True until the episode ends.", np.bool_),
    Field("held", (), "", 0.0, "True if the present stage is done.", np.bool_),
    Field("succeeded", (), "", 0.0, "True if the task is done.", np.bool_),
    Field("terminated", (), "", 0.0, "True if a crash or success ended the episode.", np.bool_),
    Field("truncated", (), "", 0.0, "True if the time limit ended the episode.", np.bool_),
)
"""Quantities that a reset sets."""

ENVIRONMENT = (*_KEPT, *_BEGINS)  # All quantities of an environment

SETTINGS = (
    Field("level", (), "", None, "Input of actions: SETPOINTS, RATES or ROTORS.", np.int64),
    Field("hold", (), "", None, "Physics steps between evaluations of the force.", np.int64),
    Field("compensates", (), "", None, "True if the controller compensates a force.", np.bool_),
    Field("drains", (), "", None, "True if batteries discharge.", np.bool_),
    Field("gusty", (), "", None, "True if there are gusts.", np.bool_),
    Field("twists", (), "", None, "True if interaction forces also exert a torque.", np.bool_),
    Field("bounded", (), "", None, "True if actions lie in [-1, 1].", np.bool_),
    Field("tracks", (), "", None, "True if success requires tracking the reference.", np.bool_),
    Field("exchanges", (), "", None, "True if drones may exchange goals.", np.bool_),
    Field("end_on_success", (), "", None, "True if success ends the episode.", np.bool_),
    Field("ends_team", (), "", None, "True if a contact ends the team's episode.", np.bool_),
    Field("bounces", (), "", None, "True if drones bounce at contacts.", np.bool_),
    Field("arena", (2, 3), "m", None, "Corners of the arena."),
    Field("gust_kept", (), "", None, "Factor by which a gust decays in a physics step."),
    Field("gust_strength", (), "m/s^2", None, "Standard deviation of the gusts."),
    Field("idle_current", (), "A", None, "Current with the rotors at rest."),
    Field("current_per_newton", (), "A/N", None, "Current per newton of thrust."),
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
    Field("min_vertical_thrust_fraction", (), "", None, "Least vertical force over the weight."),
    Field("thrust_rate_blend", (), "", None, "Low-pass on the derivative of the thrust."),
    Field("rate_error_blend", (), "", None, "Low-pass on the derivative of the rate error."),
    Field("desired_rate_blend", (), "", None, "Low-pass on the desired body rate."),
    Field("lead", (), "", None, "1 with lag compensation, 0 without."),
    Field("adaptation", (), "", None, "Adaptation: see `swarm_envs.control.config`.", np.int64),
    Field("residual_filter", (4,), "1, s, 1/s, 1", None, "Low-pass of the residual, for a step."),
    Field("adaptive_kept", (), "", None, "Decay of Neural-Fly's coefficients in a step."),
    Field("adaptive_drift", (3,), "", None, "Process noise of these coefficients in a step."),
    Field("adaptive_noise", (), "m^2/s^4", None, "Variance of Neural-Fly's measurements."),
    Field("decision_rate", (), "1/s", None, "Decisions per second.", np.int64),
    Field("decision_s", (), "s", None, "Time between decisions."),
    Field("horizon_s", (), "s", None, "Time limit."),
    Field("stage_s", (), "s", None, "Time for each stage; 0 if there is only one."),
    Field("ramp", (), "", None, "Ramp of the reference: see `swarm_envs.tasks.motion.Motion`."),
    Field("success_radius", (), "m", None, "Largest distance from goal or reference for success."),
    Field("hold_s", (), "s", None, "Time for which all drones must stay there."),
    Field("settle_s", (), "s", None, "Time from which errors count."),
    Field("least_score", (), "", None, "Least score of a success at the time limit."),
    Field("goal_reach", (2,), "m", None, "Least and largest distance of the next goal."),
    Field("noise", (4,), "m, m/s, rad, rad/s", None, "Standard deviations of observations."),
    Field("residual_kept", (), "", None, "Factor by which the random force decays in a step."),
    Field("residual_sideways", (), "", None, "Horizontal random force over the vertical one."),
    Field("velocity_walk", (), "m/s", None, "Noise of the estimated velocity in a step."),
    Field("attitude_walk", (), "rad", None, "Noise of the estimated attitude in a step."),
    Field("frames_per_step", (), "", None, "Frames of motion capture in a step."),
    Field("frame_delay", (), "s", None, "Age of a frame when it arrives."),
    Field("frame_loss", (), "", None, "Probability that a frame is lost."),
    Field("frame_noise", (2,), "m, rad", None, "Standard deviations of a frame."),
    Field("frame_gain", (3,), "1, 1/s, 1", None, "Gains of a frame: position, velocity, attitude."),
)
"""Constant quantities of all environments."""

_SCRATCH = (
    Field("yaw_sin", (), "", None, "Sine of half the yaw angle."),
    Field("yaw_cos", (), "", None, "Cosine of half the yaw angle."),
    Field("desired_force", (3,), "N", None, "Desired force of the position loop."),
    Field("rate_derivative", (3,), "rad/s^2", None, "Derivative of the commanded body rates."),
    Field("body_rate", (3,), "rad/s", None, "Angular velocity in the body frame."),
    Field("torque", (3,), "N m", None, "Torque of the rate loop without its gyroscopic part."),
    Field("residual", (3,), "N", None, "Force besides nominal thrust and feed-forward."),
    Field("old_velocity", (3,), "m/s", None, "Velocity one step ago."),
    Field("old_feedforward", (3,), "N", None, "Interaction force compensated one step ago."),
    Field("stream", (), "", None, "State of the drone's stream of random numbers.", np.uint64),
    Field("seen_position", (3,), "m", None, "Estimated position in the hall."),
    Field("seen_quaternion", (4,), "", None, "Estimated attitude in the hall."),
    Field("seen_velocity", (3,), "m/s", None, "Estimated velocity in the hall."),
    Field("seen_angular_velocity", (3,), "rad/s", None, "Estimated angular velocity in the hall."),
)
"""Scratch columns of a block."""


def record_type(fields: tuple[Field, ...], lanes: int | None = None) -> np.dtype[np.void]:
    """Return the record type of a table; with `lanes`, that of this number of drones side by side.

    Its fields are attributes also in interpreted kernels.
    """
    last = () if lanes is None else (lanes,)
    plain = np.dtype([(f.name, f.kind, (*f.shape, *last)) for f in fields], align=True)
    return np.dtype((np.record, plain))


LANES = 8
"""Drones in a block. A quantity of eight drones fills a row of 64 bytes, which is one register of
AVX-512 and two of AVX2: loops over lanes are vectorized."""

DRONE_TYPE = record_type(DRONE)
SENSED_TYPE = record_type(_BODY)
"""The record type of the measured state of a drone."""
ENVIRONMENT_TYPE = record_type(ENVIRONMENT)
SETTINGS_TYPE = record_type(SETTINGS)
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
"""The record type of a block: the quantities of `LANES` drones in a physics step."""


def _columns(fields: tuple[Field, ...]) -> int:
    return record_type(fields).itemsize // 8


BODY_END = _columns((*_BODY, *_CONTACT, *_METRICS))
"""End of the columns that every physics step reads and writes."""
CONTROLLER_END = BODY_END + _columns(_CONTROLLER)
"""End of the columns of the tracking controller, which begin at `BODY_END`."""
VEHICLE_END = CONTROLLER_END + _columns(_VEHICLE)
"""End of the columns, from `CONTROLLER_END`, that physics steps never write back."""
ADAPTATION_END = VEHICLE_END + _columns(_ADAPTATION)
"""End of the columns of adaptation, which begin at `VEHICLE_END`."""
_HALL_CHANGED = ADAPTATION_END + _columns(_HALL_VARIES)
HALL_ENDS = (_HALL_CHANGED, _HALL_CHANGED + _columns(_HALL_STAYS))
"""Ends of the columns of the hall, from `ADAPTATION_END`: of those that change, and of those that
physics steps never write back."""
ACTIVE = int(dict(DRONE_TYPE.fields or ())["active"][1]) // 8
"""The column of `active`."""

LINE = 64  # Bytes of a cache line


def aligned(count: int, row: np.dtype[np.void]) -> Records:
    """Return zeros that begin at a cache line, for vector loads and stores."""
    memory = np.zeros(count * row.itemsize + LINE, np.uint8)
    start = -memory.ctypes.data % LINE
    return memory[start : start + count * row.itemsize].view(np.dtype((np.record, row)))


class World(NamedTuple):
    """The state of E environments of N drones."""

    drones: Records
    """(E, N) records of `DRONE`."""
    environments: Records
    """(E,) records of `ENVIRONMENT`."""
    goals: npt.NDArray[np.float64]
    """(E, S, N, 3) goal positions of each stage, m, world frame."""

    def copy(self) -> World:
        """Return a copy."""
        return World(self.drones.copy(), self.environments.copy(), self.goals.copy())

    @property
    def columns(self) -> npt.NDArray[np.float64]:
        """The memory of the drones as floats (E, N, columns)."""
        return as_columns(self.drones)


def as_columns(drones: Records) -> npt.NDArray[np.float64]:
    """Return the memory of records (E, N) as floats (E, N, columns)."""
    return drones.view(np.float64).reshape(*drones.shape, -1)


def new_world(num_envs: int, num_drones: int, num_stages: int = 1) -> World:
    """Return the tables of environments, all zeros."""
    return World(
        np.zeros((num_envs, num_drones), DRONE_TYPE),
        np.zeros(num_envs, ENVIRONMENT_TYPE),
        np.zeros((num_envs, num_stages, num_drones, 3)),
    )


def _reset_columns(
    fields: tuple[Field, ...],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Return the columns of a drone that a reset of these fields sets, and their values."""
    offsets = {name: entry[1] // 8 for name, entry in (DRONE_TYPE.fields or {}).items()}
    found = [
        (column, field.reset)
        for field in fields
        if field.reset is not None
        for column in range(offsets[field.name], offsets[field.name] + math.prod(field.shape))
    ]
    columns, values = zip(*found, strict=True)
    return np.array(columns), np.array(values)


RESET_COLUMNS, RESET_VALUES = _reset_columns(DRONE)
"""Columns of a drone that a reset sets, and their values."""
CONTACT_COLUMNS, CONTACT_VALUES = _reset_columns(_CONTACT)
"""Columns of contacts, which every decision resets, and their values."""
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
"""The record type of an environment in which all quantities of a reset are one field."""


def clear_environments(environments: Records, where: npt.NDArray[np.int64]) -> None:
    """Set the quantities of these environments (M,) to their values at a reset."""
    environments.view(_RESET_PART)["begun"][where] = _BEGUN.view(_RESET_PART)["begun"]

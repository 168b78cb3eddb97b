"""Agents from trained models and functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from swarm_envs.agents.features import feature_sizes, features_of
from swarm_envs.agents.protocol import RowAgent
from swarm_envs.envs.observation import Float32Array, observation_width
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.errors import check_parameters

__all__ = ["ModelAgent", "from_model"]

_OPTIONS = (
    "action",
    "decision_rate",
    "controller",
    "observation",
    "num_neighbors",
    "num_obstacles",
    "observe_load",
    "observe_force",
    "observe_setpoint",
)
"""Options of an environment that define a model's observations and actions."""


class ModelAgent(RowAgent):
    """Agent that applies one model to the observation row of every drone.

    Args:
        act: a function that maps observation rows (n, row width) to actions (n, width), float32.
        requires: environment options that the model was trained with; none by default.
    """

    def __init__(
        self, act: Callable[[Float32Array], Any], requires: Mapping[str, Any] | None = None
    ) -> None:
        self._act = act
        self.requires: Mapping[str, Any] = {} if requires is None else dict(requires)

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Do nothing, as the agent has no memory."""

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Return actions (..., width) for observation rows (..., row width).

        Raises:
            ValueError: the model returns another number of actions than there are rows.
        """
        flat = np.ascontiguousarray(rows.reshape(-1, rows.shape[-1]), np.float32)
        actions = np.asarray(self._act(flat), np.float32)
        if actions.ndim != 2 or len(actions) != len(flat):
            raise ValueError(
                f"the model returned actions of shape {actions.shape} for rows of shape "
                f"{flat.shape}, but must return one row of actions for each row"
            )
        return actions.reshape(*rows.shape[:-1], -1)


def from_model(model: Any, env: SwarmParallelEnv) -> ModelAgent:
    """Return an agent that acts with a model.

    Args:
        model: a model of Stable-Baselines3 that was trained on `SharedPolicyVecEnv`, with its
            features or with rows; or a torch module or a function that maps observation rows (n,
            row width), float32, to actions (n, width). Actions are clipped to [-1, 1] if the action
            mode is bounded. A model that was trained with `VecNormalize` must still have that
            environment, whose statistics are used.
        env: an environment with the options that the model was trained with.

    Raises:
        TypeError: the model is none of these, or is recurrent.
        ValueError: the environment's observations are not flat rows, or a model of
            Stable-Baselines3 was trained on neither its rows nor its features.
    """
    if env.core.config.observation != "flat":
        raise ValueError(
            f"env has observation={env.core.config.observation!r}, but agents of models need flat "
            "rows; make it with observation='flat'"
        )
    act = _function_of(model, env)
    bounded = env.core.mode.bounded

    def clipped(rows: Float32Array) -> Any:
        actions = act(rows)
        return np.clip(actions, -1.0, 1.0) if bounded else actions

    config = env.core.config
    return ModelAgent(clipped, {name: getattr(config, name) for name in _OPTIONS})


def _function_of(model: Any, env: SwarmParallelEnv) -> Callable[[Float32Array], Any]:
    if hasattr(model, "predict") and hasattr(model, "observation_space"):
        if hasattr(model.policy, "lstm_actor"):
            raise TypeError(
                "model is recurrent, but an agent of a model has no memory; give a model without"
            )
        observe, normalizer = _observed_by(model, env), model.get_vec_normalize_env()
        if normalizer is None:
            return lambda rows: model.predict(observe(rows), deterministic=True)[0]
        return lambda rows: model.predict(
            normalizer.normalize_obs(observe(rows)), deterministic=True
        )[0]
    if hasattr(model, "parameters") and callable(model):
        return lambda rows: _through_torch(model, rows)
    if callable(model):
        check_parameters("model", model, "rows")
        return lambda rows: np.asarray(model(rows))
    raise TypeError(
        f"model is {model!r:.80}, but must be a model of Stable-Baselines3, a torch module, or a "
        "function that maps observation rows to actions"
    )


def _observed_by(model: Any, env: SwarmParallelEnv) -> Callable[[Float32Array], Float32Array]:
    """Return the function that maps rows to the observations of a Stable-Baselines3 model."""
    form, expected = env.core.form[1:], model.observation_space.shape
    if expected is None:
        raise ValueError(
            "the model observes dictionaries, but agents of models need flat rows; train it on "
            "SharedPolicyVecEnv with observation='flat'"
        )
    if expected == (observation_width(*form),):
        return lambda rows: rows
    if expected == (feature_sizes(*form).width,):
        return lambda rows: features_of(rows, *form)
    raise ValueError(
        f"the model observes {expected}, but rows of this environment have "
        f"{observation_width(*form)} numbers and {feature_sizes(*form).width} features; make the "
        "environment with the options of its training, such as num_neighbors, or give a function "
        "of rows for observations of your own: lambda rows: model.predict(own(rows))[0]"
    )


def _through_torch(module: Any, rows: Float32Array) -> Any:
    import torch

    with torch.no_grad():
        return module(torch.from_numpy(rows)).numpy()

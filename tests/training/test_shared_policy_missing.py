"""Without Stable-Baselines3, asking for its interface says what to install."""

from __future__ import annotations

import sys

import pytest

import swarm_envs.training


@pytest.fixture
def without_sb3(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "stable_baselines3"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.delitem(sys.modules, "swarm_envs.training.shared_policy", raising=False)


def test_says_what_to_install(without_sb3):
    message = r"SharedPolicyVecEnv needs Stable-Baselines3.*pip install 'swarm-envs\[train\]'"
    with pytest.raises(ImportError, match=message):
        swarm_envs.training.SharedPolicyVecEnv  # noqa: B018
    with pytest.raises(ImportError, match=message):
        from swarm_envs.training.shared_policy import SharedPolicyVecEnv  # noqa: F401


def test_other_names_are_not_there():
    with pytest.raises(AttributeError, match="has no attribute 'SharedPolicyEnv'"):
        swarm_envs.training.SharedPolicyEnv  # noqa: B018

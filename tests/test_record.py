"""Datasets: Minari loads them, and the environment that it recovers flies the same again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from swarm_envs import TASKS, task_family
from swarm_envs.agents import load, recommended
from swarm_envs.cli import main
from swarm_envs.commands import record
from swarm_envs.commands.fly import find_task

minari = pytest.importorskip("minari", reason="the extra `minari`")
pytest.importorskip("h5py")
pytestmark = pytest.mark.filterwarnings("default::UserWarning:minari")


def command(out: Path, *more: str) -> list[str]:
    given = ["record", "--task", "swap", "--drones", "3", "--agent", "fast-line", "--name", "a-v0"]
    return [*given, "--flights", "4", "--out", str(out), *more]


def loaded(out: Path) -> Any:
    return minari.MinariDataset(out / "a-v0" / "data")


def flat(dataset: Any) -> list[Any]:
    """All numbers of a dataset."""
    names = ("observations", "actions", "rewards", "terminations", "truncations")
    return [getattr(episode, name) for episode in dataset for name in names]


def same(one: Any, other: Any) -> bool:
    return all(map(np.array_equal, flat(one), flat(other))) and len(flat(one)) == len(flat(other))


@pytest.mark.parametrize(
    "more",
    [
        (),
        ("--agent", "random", "--physics", "bullet"),  # one flight at a time
        ("--task", "crowd", "--drones", "8", "--agent", "straight-line", "--horizon-s", "4"),
    ],
)
def test_what_minari_loads_is_what_its_environment_flies(tmp_path, monkeypatch, more):
    monkeypatch.chdir(tmp_path)
    assert main(command(Path("out"), *more)) == 0
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "out"))
    dataset = minari.load_dataset("a-v0")
    assert dataset.total_episodes == 4
    check_flights(dataset, dataset.recover_environment())


def test_a_controller_is_recovered_by_the_agent_that_requires_it(tmp_path):
    assert main(command(tmp_path, "--agent", "air-aware", "--horizon-s", "3")) == 0
    dataset = loaded(tmp_path)
    env = dataset.recover_environment()
    assert env.unwrapped.parallel.core.config.controller == load("air-aware").requires["controller"]
    check_flights(dataset, env)


def test_a_controller_of_one_s_own_leaves_no_environment(tmp_path):
    """Minari cannot keep it; whoever has it makes the environment."""
    file = tmp_path / "mine.py"
    file.write_text(
        "from swarm_envs.agents.scripted import DetourAgent\n"
        "from swarm_envs.control.config import ControllerConfig, Indi\n"
        "def mine(): return DetourAgent(ControllerConfig(adaptation=Indi()))\n"
    )
    mine = f"{file}:mine"
    assert main(command(tmp_path / "out", "--agent", mine, "--horizon-s", "3")) == 0
    dataset = loaded(tmp_path / "out")
    given = {"num_drones": 3, "physics": "batch", "horizon_s": 3.0, **load(mine).requires}
    check_flights(dataset, gymnasium.make("swarm_envs/Swap-v1", **given))
    with pytest.raises((ValueError, AttributeError, AssertionError)):
        dataset.recover_environment()


FAMILIES = sorted({task_family(task) for task in TASKS})


@pytest.mark.parametrize("family", FAMILIES)
def test_every_task_has_a_dataset_of_its_best_agent(tmp_path, monkeypatch, family):
    given = ["record", "--task", family, "--flights", "1", "--out", str(tmp_path)]
    assert main([*given, "--horizon-s", "0.5", "--name", f"{family}-v0"]) == 0
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    dataset = minari.load_dataset(f"{family}-v0")
    env = dataset.recover_environment()
    drones = len(env.unwrapped.parallel.possible_agents)
    best = recommended(find_task(family), num_drones=drones)
    assert dataset.storage.metadata["algorithm_name"] == best
    check_flights(dataset, env, flights=1)


def check_flights(dataset: Any, env: Any, flights: int = 4) -> None:
    """Fly all actions again."""
    assert env.observation_space == dataset.observation_space
    assert env.action_space == dataset.action_space
    told = dataset.storage.get_episode_metadata(range(flights))
    for episode, about in zip(dataset, told, strict=True):
        seen, _ = env.reset(seed=int(about["seed"]))
        np.testing.assert_array_equal(seen, episode.observations[0])
        for t, action in enumerate(episode.actions):
            seen, reward, terminated, truncated, info = env.step(action)
            np.testing.assert_array_equal(seen, episode.observations[t + 1])
            assert reward == pytest.approx(episode.rewards[t], abs=1e-12)
            assert (terminated, truncated) == (episode.terminations[t], episode.truncations[t])
        assert terminated or truncated
        assert info["episode_metrics"]["success"] == episode.infos["success"][-1]
    env.close()


def test_episodes_of_drones_are_their_parts_of_the_team_s(tmp_path):
    crowd = ("--task", "crowd", "--drones", "8", "--agent", "straight-line", "--horizon-s", "4")
    for rows in ("team", "drone"):
        assert main(command(tmp_path / rows, *crowd, "--rows", rows)) == 0
    teams, drones = loaded(tmp_path / "team"), [*loaded(tmp_path / "drone")]
    assert len(drones) == 4 * 8
    lengths = set()
    for k, episode in enumerate(drones):
        team = teams[k // 8]
        rows = team.observations.reshape(len(team.observations), 8, -1)[:, k % 8]
        acts = team.actions.reshape(len(team.actions), 8, -1)[:, k % 8]
        count = len(episode)
        lengths.add(count)
        np.testing.assert_array_equal(episode.observations, rows[: count + 1])
        np.testing.assert_array_equal(episode.actions, acts[:count])
        assert not rows[count + 1 :].any()  # it has ended before its team
        assert episode.terminations[-1] != episode.truncations[-1]
        assert episode.terminations[-1] or count == len(team)
        assert not (episode.terminations | episode.truncations)[:-1].any()
    assert len(lengths) > 3


def test_killed_it_goes_on_and_the_same_seed_gives_the_same(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(record, "_MOST_AT_ONCE", 2)
    assert main(command(tmp_path / "whole")) == 0
    fly, calls = record._fly, []

    def stopped(*given):
        calls.append(given)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return fly(*given)

    monkeypatch.setattr(record, "_fly", stopped)
    assert main(command(tmp_path / "killed")) != 0
    assert not (tmp_path / "killed" / "a-v0").exists()
    assert main(command(tmp_path / "killed", "--seed", "1")) == 1
    assert "flights of other options" in capsys.readouterr().err
    assert main(command(tmp_path / "killed")) == 0
    assert len(calls) == 3  # two parts, of which the second was begun twice
    assert same(loaded(tmp_path / "killed"), loaded(tmp_path / "whole"))
    assert [path.name for path in (tmp_path / "killed").iterdir()] == ["a-v0"]
    assert main(command(tmp_path / "other", "--seed", "1")) == 0
    assert not same(loaded(tmp_path / "other"), loaded(tmp_path / "whole"))


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (("--agent", "fast-lin"), "did you mean 'fast-line'"),
        (("--name", "a b"), "a b"),
        (("--rows", "row"), "row"),
    ],
)
def test_what_cannot_be_recorded_is_refused(tmp_path, refused, more, why):
    assert why in refused(*command(tmp_path, *more))
    assert not [*tmp_path.iterdir()]


def test_a_dataset_is_never_replaced(tmp_path, capsys):
    (tmp_path / "a-v0").mkdir()
    assert main(command(tmp_path)) == 2
    assert "choose another --name" in capsys.readouterr().err

"""Recorded episodes: what is kept is what happened, and a file gives back what it was given."""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v0
from swarm_envs.agents import load, record_episode
from swarm_envs.viewing.record import Recorder, Recording
from swarm_envs.viewing.solids import Solid, solids
from swarm_envs.viewing.summary import outcome
from swarm_envs.viewing.trajectory import COLUMNS, read_trajectory, write_trajectory


@pytest.fixture(scope="module")
def flight() -> Recording:
    """Three drones that act at random until one of them hits something."""
    env = swap_v0.parallel_env(team="SLS", physics="batch")
    recording = record_episode(env, load("random"), seed=3)
    env.close()
    return recording


def same(one: Recording, other: Recording) -> bool:
    for name in (field.name for field in fields(Recording)):
        a, b = getattr(one, name), getattr(other, name)
        if isinstance(a, np.ndarray):
            if a.dtype != b.dtype:
                return False
            np.testing.assert_array_equal(a, b)
        elif name == "reward_terms":
            assert list(a) == list(b)
            for term in a:
                np.testing.assert_array_equal(a[term], b[term])
        elif a != b:
            return False
    return True


def test_a_recording_is_what_a_loop_of_env_step_sees(flight):
    env = swap_v0.parallel_env(team="SLS", physics="batch")
    agent = load("random")
    observations, _ = env.reset(seed=3)
    agent.reset(env, 3)
    k, infos = 0, dict[str, Any]()
    while env.agents:
        np.testing.assert_array_equal(flight.position[k], env.view.state.position)
        observations, rewards, *_, infos = env.step(agent.act(observations, None))
        k += 1
        assert flight.time[k] == env.view.time
        assert flight.reward[k].tolist() == list(rewards.values())
        for i, info in enumerate(infos.values()):
            kept = {name: term[k, i] for name, term in flight.reward_terms.items()}
            assert kept == info["reward_terms"]
            assert flight.contact_floor[k, i] == info["contact"]["floor"]
            assert flight.contact_wall[k, i] == info["contact"]["wall"]
    assert k == len(flight.time) - 1
    assert flight.about.metrics == infos["drone_0"]["episode_metrics"]
    np.testing.assert_array_equal(flight.goal[0], env.view.goals)
    env.close()


def test_a_recording_agrees_with_itself(flight):
    task = swap_v0.parallel_env(team="SLS", physics="batch").core.task
    weighted = sum(w * flight.reward_terms[name] for name, w in task.reward_weights.items())
    np.testing.assert_allclose(flight.reward[1:], weighted[1:], atol=1e-12)
    assert np.isnan(flight.reward[0]).all()  # nothing had been flown
    mean = (flight.velocity[1:] + flight.velocity[:-1]) / 2
    moved = np.diff(flight.position, axis=0) * flight.about.decision_rate
    np.testing.assert_allclose(moved, mean, atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(flight.quaternion, axis=-1), 1.0)
    assert (flight.about.task, flight.about.agent, flight.about.seed) == (
        "swap_v0",
        "RandomAgent",
        3,
    )


def test_recordings_that_are_cut_short_say_so():
    env = swap_v0.parallel_env(team="S", physics="batch")
    recorder = Recorder()
    env.reset(seed=0)
    recorder(env)
    env.step({"drone_0": np.zeros(3, np.float32)})
    recorder(env)
    cut = recorder.record()
    assert np.isnan(cut.reward).all()
    assert outcome(cut) == "Recorded for 0.02 s; the episode had not ended."
    env.close()


@pytest.mark.parametrize("suffix", [".parquet", ".npz"])
def test_a_file_gives_back_what_it_was_given(flight, tmp_path, suffix):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    walls = (Solid(True, (0.0, 0.0, 0.0), (0.2, 0.2, 2.5)),)
    given = replace(flight, about=replace(flight.about, solids=walls))
    path = tmp_path / f"a{suffix}"
    write_trajectory(path, given)
    assert same(read_trajectory(path), given)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_the_table_has_a_row_for_each_drone_at_each_time(flight, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    write_trajectory(path, flight)
    table = parquet.read_table(path)
    terms = [f"reward_{name}" for name in flight.reward_terms]
    assert table.column_names == [*COLUMNS, *terms]
    rows = table.to_pylist()
    assert len(rows) == 3 * len(flight.time)
    row = rows[3 * 5 + 1]  # the sixth time, the second drone
    assert (row["drone"], row["type"], row["time"]) == ("drone_1", "L", 5 / 48)
    assert [row["x"], row["y"], row["z"]] == flight.position[5, 1].tolist()
    assert row["z_goal"] == flight.goal[5, 1, 2]
    assert row["thrust3"] == flight.rotor_thrust[5, 1, 2]
    assert row["contact_drone"] == -1


def test_files_that_hold_no_episode_are_refused(flight, tmp_path):
    np.savez(tmp_path / "a.npz", x=np.zeros(3))
    with pytest.raises(ValueError, match=r"a\.npz holds no episode: it lacks about, time, pos"):
        read_trajectory(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", x=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="not an npz file"):
        read_trajectory(tmp_path / "b.npz")
    (tmp_path / "c.npz").write_text("text")
    with pytest.raises(ValueError, match="not an npz file"):
        read_trajectory(tmp_path / "c.npz")
    with pytest.raises(FileNotFoundError):
        read_trajectory(tmp_path / "none.npz")
    with pytest.raises(ValueError, match=r"unknown suffix '\.csv'.*'\.npz', '\.parquet'"):
        write_trajectory(tmp_path / "a.csv", flight)


def test_tables_of_other_things_are_refused(flight, tmp_path):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    parquet.write_table(arrow.table({"x": [1.0]}), path)
    with pytest.raises(ValueError, match="holds no episode"):
        read_trajectory(path)
    path.write_text("text")
    with pytest.raises(ValueError, match="not a Parquet file"):
        read_trajectory(path)
    write_trajectory(path, flight)
    table = parquet.read_table(path)
    parquet.write_table(table.drop_columns(["z"]), path)
    with pytest.raises(ValueError, match="lacks z"):
        read_trajectory(path)
    parquet.write_table(table.slice(0, 4), path)
    with pytest.raises(ValueError, match="4 rows, no multiple of its 3 drones"):
        read_trajectory(path)


def test_without_pyarrow_the_message_says_how_to_get_it(flight, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ImportError, match=r"swarm-envs\[parquet\].*\.npz"):
        write_trajectory(tmp_path / "a.parquet", flight)


class Block:
    low, high = (0.0, 0.1, 0.2), (1.0, 1.1, 9.0)


class Post:
    center, radius, height = (1.0, -1.0), 0.25, 1.5


def test_obstacles_become_solids_below_the_ceiling():
    block, post = solids([Block(), Post()], ceiling=2.5)
    assert block == Solid(False, (0.0, 0.1, 0.2), (1.0, 1.1, 2.5))
    assert post == Solid(True, (0.75, -1.25, 0.0), (1.25, -0.75, 1.5))
    assert block.rings().shape == (2, 4, 3)
    ring = post.rings()[1]
    np.testing.assert_allclose(np.linalg.norm(ring[:, :2] - Post.center, axis=1), 0.25)
    assert (ring[:, 2] == 1.5).all()

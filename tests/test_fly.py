"""The command `fly`: what it writes, what it refuses, what it calls a failure."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from swarm_envs.cli import main
from swarm_envs.viewing import video as films
from swarm_envs.viewing.trajectory import read_trajectory

OWN_TASK = Path(__file__).parents[1] / "examples" / "own_task.py"
STACKED = ["fly", "--layout", "stacked", "--team", "L2S", "--physics", "batch", "--seed", "1"]


def crash(tmp_path: Path) -> Path:
    """A user's file with an agent that flies into the ground."""
    file = tmp_path / "mine.py"
    file.write_text(
        "import numpy as np\n"
        "class Down:\n"
        "    requires, privileged = {'action': 'acceleration'}, False\n"
        "    def reset(self, env, seed): self.seed = seed\n"
        "    def act(self, observations, view):\n"
        "        assert view is None\n"
        "        return {name: np.array([0, 0, -1], np.float32) for name in observations}\n",
        encoding="utf-8",
    )
    return file


def test_a_flight_is_printed_and_written(capsys, tmp_path):
    numbers, path = tmp_path / "a.json", tmp_path / "a.npz"
    files = ["--json", str(numbers), "--trajectory", str(path)]
    assert main([*STACKED, "--agent", "tracking+compensated", *files]) == 0
    said = capsys.readouterr()
    assert "Success, after" in said.out
    metrics = json.loads(numbers.read_text())["metrics"]
    assert f"Goals     all 2 drones, the last after {metrics['time_to_goal_s']:.2f} s" in said.out
    assert f"Distance  {metrics['minimum_separation_m']:.3f} m at the closest; no near" in said.out
    assert f"Force     {metrics['worst_force_g']:.1f} g at most; thrust reserve 31.0 g" in said.out
    assert f"Height    {100 * metrics['worst_height_error_m']:.1f} cm" in said.out
    assert "worst; good, at most 5 cm" in said.out
    assert "sees the true state" in said.out
    assert "100%" in said.err
    written, recording = json.loads(numbers.read_text()), read_trajectory(path)
    assert written["metrics"] == recording.about.metrics
    assert (written["team"], written["agent"], written["seed"]) == ("LS", "tracking+compensated", 1)
    assert recording.about.seed == 1
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.json", "a.npz"]


@pytest.mark.parametrize(
    ("scaled", "reserve"),
    [("mass=1.5:1.5", 65.0 - 1.5 * 34.0), ("thrust=0.8:0.8", 0.8 * 65.0 - 34.0)],
)
def test_the_thrust_reserve_is_that_of_the_episode(scaled, reserve, capsys):
    flight = ["--physics", "batch", "--agent", "hover", "--horizon-s", "0.1"]
    assert main(["fly", *flight, "--randomization", scaled]) == 0
    assert f"thrust reserve {reserve:.1f} g" in capsys.readouterr().out


def test_a_delay_need_not_be_a_multiple_of_any_decision(capsys):
    limited = ["--physics", "batch", "--observe-delay-s", "0.1", "--horizon-s", "0.3"]
    assert main(["fly", *limited]) == 0
    assert main(["fly", *limited, "--agent", "detour"]) == 0
    assert "limits of communication hold for observations only" in capsys.readouterr().out
    assert main(["fly", "--agent", "tracking", "--observe-loss", "nan"]) == 2
    assert "error: observe_loss is nan" in capsys.readouterr().err


def test_a_crash_is_a_result_and_not_a_failure(capsys, tmp_path):
    numbers = tmp_path / "a.json"
    agent = f"{crash(tmp_path)}:Down"
    arguments = ["--physics", "batch", "--drones", "2", "--agent", agent, "--json", str(numbers)]
    assert main(["fly", *arguments]) == 0
    assert "hits the floor" in capsys.readouterr().out
    written = json.loads(numbers.read_text())
    assert not written["metrics"]["success"]
    assert written["events"][-1]["kind"] == "floor"
    assert written["events"][-1]["time_s"] == written["metrics"]["length_s"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--task", "swop"], "did you mean 'swap'?"),
        (["--layout", "staked"], "did you mean 'stacked'?"),
        (["--layout", "forest", "--agent", "crowd-dagger"], "--task crowd has 'forest'"),
        (["--task", "ring", "--layout", "chase"], "'ring' has no layouts; leave it out; --task pu"),
        (["--agent", "tracing"], "did you mean 'tracking'?"),
        (["--agent", "none.py:Agent"], "there is no file 'none.py'"),
        (["--team", "SXL"], "unknown vehicle token"),
        (["--team", "L3S"], "write a letter for each drone, such as 'LLLSSS'"),
        (
            ["--neighbors", "2", "--agent", "swap-dagger"],
            "'swap-dagger' cannot fly: it requires num_neighbors=7, not 2; leave that option out",
        ),
        (["--physics", "bulet"], "did you mean 'bullet'?"),
        (["--agent", "hover", "--obstacles", "box=-9:-9:0:9:9:5"], "error: found room for 0 of 4"),
        (["--neighbors", "20000"], "--neighbors is 20000, but must be an integer of at least 0"),
        (["--drones", "200000"], "--drones is 200000, but must be an integer of at least 1"),
        (["--layout", "circle", "--drones", "200"], "or a smaller spacing_m: CircleLayout"),
        (["--randomization", "mass=2"], "mass=2, but must be a range, mass=LOW:HIGH"),
        (["--video", "a.avi"], "--video is 'a.avi', but must end in .mp4 or .gif"),
        (["--trajectory", "a.csv"], "must end in .parquet or .npz"),
        (["--replay", "a.htm"], "must end in .html"),
        (["--env", "start_radius"], "--env has 'start_radius', but must have NAME=VALUE"),
        (["--env", "a=1", "a=2"], "--env has 'a' twice"),
        (
            ["--env", "a=1", "--env", "b=2"],
            "--env is given twice; give it once, with",
        ),
        (["--env=a=1", "--env=b=2"], "--env is given twice"),
        (["--env", "end_on_success=false"], "is a string; write end_on_success=False"),
        (["--env", "end_on_success=no"], "is a string; write end_on_success=False"),
        (["--env"], "--env has no value; give NAME=VALUE, or leave the option out"),
        (["--env", "--seed", "1"], "--env has no value"),
        (["--env", "spacing_m={1,2}"], "--env has spacing_m={1, 2}, but values are finite numbers"),
        (["--env", "spacing_m=1e999"], "--env has spacing_m=inf, but values are finite numbers"),
        (["--env", "reward_weights={0:1}"], "whose keys are strings"),
        (["--env", "num_drones=5"], "--env has 'num_drones', which has its own option; use --dro"),
        (["--env", "end_on_sucess=False"], "did you mean 'end_on_success'?"),
        (["--task", f"{OWN_TASK}:LinTask"], "error: unknown class or function 'LinTask'"),
    ],
)
def test_what_cannot_be_flown_is_refused_first(arguments, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["fly", "--json", "a.json", *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "decision/s" not in error  # no bar: nothing flew
    assert not list(tmp_path.iterdir())


def test_what_is_not_installed_is_asked_for_before_the_flight(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["fly", "--trajectory", str(tmp_path / "a.parquet"), "--agent", "hover"]) == 1
    assert "swarm-envs[parquet]" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_out_writes_npz_without_pyarrow(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    out = tmp_path / "out"
    arguments = ["--physics", "batch", "--horizon-s", "0.2", "--out", str(out)]
    assert main(["fly", *arguments]) == 0
    assert {"flight.json", "replay.html", "trajectory.npz"} == {file.name for file in out.iterdir()}


def test_the_options_of_a_flight_are_in_its_json(tmp_path):
    words = ["--agent", "hover", "--horizon-s", "0.2", "--interactions", "wake"]
    words += ["--env", "decision_rate=20", "reward_weights={'crash': -3.0}"]
    assert main(["fly", *words, "--physics", "batch", "--json", str(tmp_path / "a.json")]) == 0
    flown = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert flown["decision_rate"] == 20
    assert flown["options"] == {
        **{"num_drones": 4, "physics": "batch", "interactions": "wake", "horizon_s": 0.2},
        **{"decision_rate": 20, "reward_weights": {"crash": -3.0}},
    }


def test_the_first_line_has_the_conditions(capsys):
    words = ["--agent", "hover", "--horizon-s", "0.2", "--physics", "batch", "--world", "hall"]
    assert main(["fly", *words, "--env", "end_on_success=False"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == (
        "swap_v1, team SSSS, physics batch, horizon_s 0.2, world hall, end_on_success False, "
        "agent hover, seed 0"
    )
    assert main(["fly", "--task", "gates", "--agent", "hover", *words[2:6]]) == 0
    assert "world hall, agent hover" in capsys.readouterr().out  # the default of gates


def test_the_best_agent_among_obstacles_sees_them(capsys):
    column = ["--obstacles", "column=1:1:0.15", "--physics", "batch"]
    assert main(["fly", *column]) == 0
    assert "agent crowd-dagger+filter" in capsys.readouterr().out
    assert main(["fly", *column, "--agent", "swap-dagger"]) == 2
    assert "try --agent crowd-dagger+filter" in capsys.readouterr().err
    short = ["--task", "ring", "--horizon-s", "0.2"]
    assert main(["fly", *short, *column]) == 0
    assert "downwash-aware was measured without obstacles" in capsys.readouterr().out


def test_out_takes_everything(tmp_path, monkeypatch):
    pytest.importorskip("pyarrow")
    monkeypatch.setattr(films, "FPS", 2)
    out = tmp_path / "out"
    video = ["--video", str(out / "flight.mp4")]
    assert main([*STACKED, "--horizon-s", "0.5", "--out", str(out), *video]) == 0
    found = {file.name: file.stat().st_size for file in out.iterdir()}
    assert set(found) == {"flight.json", "trajectory.parquet", "replay.html", "flight.mp4"}
    assert min(found.values()) > 500

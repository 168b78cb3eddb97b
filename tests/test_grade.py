"""The command `grade`: points by known numbers, files that fail, and the starters of the course."""

from __future__ import annotations

import ast
import csv
import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.assignments import ASSIGNMENTS
from swarm_envs.cli import main
from swarm_envs.commands.grade_force import grade_model, score
from swarm_envs.commands.grade_planner import (
    HORIZON,
    LEAST_DISTANCE,
    ROUND_S,
    draw_scenario,
    positions_of,
)
from swarm_envs.commands.grading.copies import bare_source, copied_files
from swarm_envs.commands.grading.grades import Grade, write_feedback
from swarm_envs.commands.grading.remote import WorkFailed, opened
from swarm_envs.training.interaction_rows import save_rows
from tests.helpers.users_agents import FINE
from tests.helpers.wake_rows import wake_rows

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="no groups of processes")
STARTERS = Path(__file__).parent.parent / "swarm_envs" / "assignments"
SOLUTIONS = Path(__file__).parent / "solutions"

WORK = (
    f"import os, time{FINE}"
    + """
class Nan(Fine):
    def say(self): return np.full(3, np.nan)
class Dies(Fine):
    def say(self): os._exit(3)
class Sleeps(Fine):
    def say(self): time.sleep(1000)
class Sees(Fine):
    privileged = True
class Sums:
    def fit(self, rows): self.mean = rows.force_g[:, 2].mean()
    def predict(self, rows): return np.full(len(rows.force_g), self.mean) + rows.force_g[:, 2]
class Short(Sums):
    def predict(self, rows): return [1.0]
"""
)


@pytest.fixture
def work(tmp_path: Path) -> Path:
    file = tmp_path / "work.py"
    file.write_text(WORK, encoding="utf-8")
    return file


def test_points_rise_from_nothing_to_a_hundred():
    swap, controller = ASSIGNMENTS["swap"], ASSIGNMENTS["controller"]
    assert swap.points({"success_rate": 0.475}) == 50.0
    assert swap.points({"success_rate": 0.475, "collision_rate": 0.2}) == 40.0
    assert swap.points({"success_rate": 0.0}) == 0.0
    assert controller.points({"worst_height_error_m": 0.0475}) == 50.0  # less is better
    assert controller.points({"worst_height_error_m": 0.005}) == 100.0
    assert controller.points({"worst_height_error_m": None}) == 0.0


def test_files_that_fail_get_nothing_and_the_others_go_on(tmp_path, work, capsys):
    table = tmp_path / "grades.csv"
    names = [f"{work}:{name}" for name in ("Nan", "Fine", "Missing", "Dies")]
    arguments = ["--episodes", "1", "--out", str(table)]
    assert main(["grade", "--assignment", "swap", *arguments, "--agent", *names]) == 1
    with table.open(newline="") as file:
        found = {line["work"].split(":")[-1]: line for line in csv.DictReader(file)}
    assert [line["points"] for line in found.values()] == ["0.0"] * 4  # who hovers never arrives
    assert (found["Fine"]["success_rate"], found["Fine"]["error"]) == ("0.0", "")
    assert "must be finite" in found["Nan"]["error"]
    assert "unknown class or function 'Missing'" in found["Missing"]["error"]
    assert "exit code 3" in found["Dies"]["error"] and "%|" not in found["Dies"]["error"]
    assert capsys.readouterr().out.count("FAILED") == 3


def test_a_file_that_is_not_there_is_the_teacher_s_mistake(tmp_path, work, capsys):
    table, missing = tmp_path / "grades.csv", tmp_path / "none.py"
    names = [f"{work}:Fine", f"{missing}:Agent"]
    assert main(["grade", "--assignment", "swap", "--out", str(table), "--agent", *names]) == 2
    error = capsys.readouterr().err
    assert f"--agent names what is not there: {missing}; nothing was graded" in error
    assert str(work) not in error
    assert not table.exists()


def test_files_that_are_none_are_not_looked_at(tmp_path, work, capsys):
    """A pipe without an end, a device, a link to others' work, a source as large as a memory."""
    shipped = STARTERS.parent / "agents" / "weights" / "swap-dagger.safetensors"
    link, large, pipe = (tmp_path / part / "work.py" for part in ("link", "large", "pipe"))
    for file in (link, large, pipe):
        file.parent.mkdir()
    link.symlink_to(work)
    large.write_text(WORK + "X = [" + "1," * 2**20 + "]", encoding="utf-8")
    os.mkfifo(pipe)
    os.mkfifo(tmp_path / "a.safetensors")
    (tmp_path / "b.safetensors").symlink_to("/dev/zero")
    (tmp_path / "c.safetensors").mkdir()
    (tmp_path / "d.safetensors").symlink_to(tmp_path / "nothing")
    assert copied_files(f"{work}:Fine") == ""
    (tmp_path / "e.safetensors").write_bytes(shipped.read_bytes())
    assert copied_files(f"{work}:Fine") == "swap-dagger"
    works = [f"{file}:Fine" for file in (link, large, pipe)]
    assert main(["grade", "--assignment", "swap", "--episodes", "1", "--agent", *works]) == 1
    said = capsys.readouterr().out
    assert "FAILED: it is a link to another file; hand in the file itself" in said
    assert "FAILED: it is no plain file" in said
    assert "bytes, but may have 1048576" in said


def interrupt_once_there(table: Path, ended: threading.Event) -> None:
    while not table.exists() and not ended.wait(0.1):
        pass
    if not ended.wait(0.5):
        os.kill(os.getpid(), signal.SIGINT)


def test_interrupted_the_table_has_who_was_graded(work, tmp_path, capsys):
    table = tmp_path / "grades.csv"
    names = [f"{work}:Sees", f"{work}:Sleeps", f"{work}:Fine"]
    arguments = ["--episodes", "1", "--limit-s", "60", "--out", str(table), "--agent", *names]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # which xdist has put aside
    ended = threading.Event()
    watch = threading.Thread(target=interrupt_once_there, args=(table, ended))
    watch.start()
    try:
        assert main(["grade", "--assignment", "swap", *arguments]) == 130
    finally:
        ended.set()
        watch.join()
        signal.signal(signal.SIGINT, before)
    shown = capsys.readouterr()
    assert "interrupted: 1 of 3 are graded" in shown.err
    assert "* sees the true state" in shown.out
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["work"], row["privileged"]) for row in rows] == [(names[0], "True")]


def test_a_pattern_names_the_whole_class(tmp_path, capsys):
    for student in ("ann", "bob"):
        (tmp_path / student).mkdir()
        (tmp_path / student / "swap.py").write_text("", encoding="utf-8")
    pattern = f"{tmp_path}/*/swap.py:Agent"
    assert main(["grade", "--assignment", "swap", "--agent", pattern]) == 1
    said = capsys.readouterr().out
    assert said.count("unknown class or function 'Agent'") == 2
    assert "ann/swap.py:Agent" in said and "bob/swap.py:Agent" in said
    assert main(["grade", "--assignment", "swap", "--agent", f"{tmp_path}/x*/swap.py:Agent"]) == 2
    assert "no file's name matches" in capsys.readouterr().err


def force_scores(work: str, data: Path) -> dict[str, float]:
    with opened(work, "fit") as (process, _):
        return grade_model(process, data)


def test_a_force_model_is_scored_on_what_it_has_not_seen(tmp_path, work):
    data = tmp_path / "rows.npz"
    save_rows(data, wake_rows(400))
    starter = force_scores(f"{STARTERS / 'force-model' / 'force_model.py'}:MyModel", data)
    assert starter["explained"] == pytest.approx(1.0)  # its form is the truth here
    held = wake_rows(400).select(wake_rows(400).validation)
    mean = wake_rows(400).select(~wake_rows(400).validation).force_g[:, 2].mean()
    expected = score(np.full(len(held), mean), held)  # labels of held-out rows are hidden
    assert force_scores(f"{work}:Sums", data) == {**expected, "copied": ""}
    assert 0.0 < expected["explained"] < 1.0
    nothing = score(np.zeros(len(held)), held)
    assert nothing["explained"] == 0.0
    assert nothing["error_g"] == nothing["baseline_g"]
    with pytest.raises(ValueError, match="must give 100 finite numbers"):
        force_scores(f"{work}:Short", data)
    with pytest.raises(WorkFailed, match="AttributeError"):
        force_scores(f"{work}:Fine", data)


DRAFTS = {
    "controller": ("controller.py", "Observer", "Stiff", 16),
    "swap": ("swap.py", "Late", "Obstacles", 32),
    "distributed-mpc": ("planner.py", "Swerving", "Constrained", 64),
    "force-model": ("force_model.py", "FewWakes", "Wakes", 1),
    "learning": ("learner.py", "Level", "Searched", 256),
}


@pytest.mark.slow
@pytest.mark.parametrize("assignment", DRAFTS)
def test_points_are_spread_over_drafts(tmp_path, assignment):
    """The starter, a better draft and a good solution, each in another third or further apart."""
    file, better, best, episodes = DRAFTS[assignment]
    table, flights = tmp_path / "grades.csv", tmp_path / "flights"
    arguments = ["--assignment", assignment, "--episodes", str(episodes), "--out", str(table)]
    if assignment == "force-model":
        assert main(["collect", "--out", str(flights), "--teams", "SS", "--world", "hall"]) == 0
        arguments += ["--data", str(flights / "rows.npz")]
    works = [str(STARTERS / assignment / ASSIGNMENTS[assignment].work)]
    works += [f"{SOLUTIONS / file}:{name}" for name in (better, best)]
    assert main(["grade", *arguments, "--agent", *works]) == 0
    with table.open(newline="") as lines:
        first, second, third = (float(line["points"]) for line in csv.DictReader(lines))
    learned = assignment == "learning"  # there the starter learns already
    assert first > 0.0 if learned else first < 45.0
    assert first + (10.0 if learned else 2.0) < second < third - (5.0 if learned else 10.0)
    assert third > 75.0


LEARNER = """
import pathlib
import numpy as np
class Learner:
    requires, privileged, trained_s = {'action': 'acceleration', 'decision_rate': 10}, False, 0.0
    def train(self, seconds): self.trained_s = seconds
    def reset(self, env, seed): assert self.trained_s == 60.0
    def act(self, observations, view): return {n: np.zeros(3, np.float32) for n in observations}
class Silent(Learner):
    train = None
class Remembers(Learner):
    def train(self, seconds): pathlib.Path(__file__).with_name('weights').read_bytes()
class Hides(Learner):
    'hidden'  # hidden
    def train(self, seconds):
        super().train(seconds)
        assert self.__doc__ is None and 'hid' 'den' not in pathlib.Path(__file__).read_text()
"""


def test_a_learner_is_trained_before_it_flies(tmp_path, capsys):
    file, heavy, named = (tmp_path / part / "learner.py" for part in ("", "heavy", "named"))
    heavy.parent.mkdir()
    named.parent.mkdir()
    file.write_text(LEARNER, encoding="utf-8")
    heavy.write_text(LEARNER + f"WEIGHTS = {list(range(1000))}", encoding="utf-8")
    named.write_text(
        LEARNER + "".join(f"def w{k}(): pass\n" for k in range(1000)), encoding="utf-8"
    )
    (tmp_path / "weights").touch()
    works = [f"{file}:{name}" for name in ("Learner", "Hides", "Silent", "Remembers")]
    works += [f"{heavy}:Learner", f"{named}:Learner"]
    arguments = ["--assignment", "learning", "--episodes", "1", "--agent", *works]
    assert main(["grade", *arguments]) == 1
    said = capsys.readouterr().out
    assert said.count("FAILED") == 4
    assert "Permission denied" in said or "No such file" in said
    assert "its constants are" in said and "its different names are" in said


def test_a_bare_source_is_the_code_on_the_same_lines():
    for file in (STARTERS.parent / "agents").glob("*.py"):
        own, bare = ast.parse(file.read_bytes()), ast.parse(bare_source(file))
        for node in ast.walk(own):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                node.value.value = 0
        assert ast.dump(bare) == ast.dump(own)
        ends = [node.lineno for node in ast.walk(own) if isinstance(node, ast.Return)]
        assert ends == [node.lineno for node in ast.walk(bare) if isinstance(node, ast.Return)]
        assert "#" not in bare_source(file)


def test_a_controller_of_the_package_is_no_solution(tmp_path, capsys):
    file = tmp_path / "mine.py"
    file.write_text(
        "from swarm_envs.control.config import ControllerConfig\n"
        + WORK.replace("'decision_rate': 10}", "'controller': ControllerConfig()}"),
        encoding="utf-8",
    )
    arguments = ["--assignment", "controller", "--episodes", "1", "--agent", f"{file}:Fine"]
    assert main(["grade", *arguments]) == 1
    assert "unknown required option 'controller'" in capsys.readouterr().out


PLANNER = """
import os, numpy as np
class Still:
    others = set()
    def reset(self, drone, goal):
        self.others.add(drone)
        assert self.others == {drone}, "two drones think with one head"
    def plan(self, state, goal, heard, ages): return np.zeros((15, 3))
class Strong(Still):
    def plan(self, state, goal, heard, ages): return np.full((15, 3), 6.0)
"""


def test_planners_share_nothing_and_keep_their_limits(tmp_path, capsys):
    file = tmp_path / "planner.py"
    file.write_text(PLANNER, encoding="utf-8")
    works = [f"{file}:Still", f"{file}:Strong"]
    arguments = ["--assignment", "distributed-mpc", "--episodes", "2", "--agent", *works]
    assert main(["grade", *arguments, "--feedback", str(tmp_path / "feedback")]) == 1
    said = capsys.readouterr().out
    (page,) = tmp_path.rglob("failure.html")  # of who flew
    assert "No success: the time limit was reached" in page.read_text("utf-8")
    assert re.search(r"planner.py:Still +0.0  0\n", said)  # who stands still never arrives
    assert "accelerates by 6 m/s^2 on one axis, but may by at most 5" in said


def test_announced_plans_are_those_of_a_double_integrator():
    """Against a thousand small steps a round."""
    rng = np.random.default_rng(3)
    state, plan = rng.normal(size=6), rng.normal(size=(HORIZON, 3))
    place, speed, small = state[:3].copy(), state[3:].copy(), ROUND_S / 1000
    found = []
    for push in plan:
        for _ in range(1000):
            place += small * speed + 0.5 * small**2 * push
            speed += small * push
        found.append(place.copy())
    np.testing.assert_allclose(positions_of(state, plan), found, rtol=1e-9)


def test_starts_keep_apart_and_goals_are_others_starts():
    for seed in range(50):
        scenario = draw_scenario(np.random.default_rng(seed))
        apart = np.linalg.norm(scenario.starts[:, None] - scenario.starts[None], axis=-1)
        assert apart[np.triu_indices(len(apart), 1)].min() >= 2 * LEAST_DISTANCE
        same = (scenario.goals[:, None] == scenario.starts[None]).all(axis=-1)
        assert (same.sum(axis=0) == 1).all() and not same.diagonal().any()
        assert 0.0 <= scenario.loss <= 0.4


def test_feedback_names_the_rubric_and_shows_the_first_failure(tmp_path, work):
    out, table = tmp_path / "feedback", tmp_path / "grades.json"
    names = [f"{work}:Fine", f"{work}:Nan"]
    arguments = ["--episodes", "2", "--feedback", str(out), "--out", str(table), "--agent", *names]
    assert main(["grade", "--assignment", "swap", *arguments]) == 1
    fine, bad = sorted(out.iterdir())
    said = json.loads((fine / "results.json").read_text())
    assert (said["score"], said["max_score"]) == (0.0, 100.0)
    assert "success_rate: 0 gives 0 points" in said["output"]
    assert "<html" in (fine / "failure.html").read_text(encoding="utf-8")
    assert "must be finite" in json.loads((bad / "results.json").read_text())["output"]
    assert not (bad / "failure.html").exists()
    rows = json.loads(table.read_text())
    assert [row["score"] for row in rows] == [0.0, 0.0]
    assert rows[0]["assignment"] == "swap" and rows[0]["student_id"] == tmp_path.name


def test_the_feedback_says_where_the_class_stands(tmp_path):
    grades = [Grade("a.py:A", 0.0, value, "", False, "") for value in (0.1, 0.2, 0.3)]
    write_feedback(tmp_path, ASSIGNMENTS["swap"], grades)
    for place in tmp_path.iterdir():
        said = json.loads((place / "results.json").read_text())["output"]
        assert "quartiles of the 3 works so far: 0.15, 0.2, 0.25" in said


def test_assignments_are_listed_and_begun(tmp_path, capsys):
    assert main(["assignment", "list"]) == 0
    listed = capsys.readouterr().out
    assert all(f"\n{name} " in f"\n{listed}" for name in ASSIGNMENTS)
    for name, assignment in ASSIGNMENTS.items():
        folder = tmp_path / name
        assert main(["assignment", "start", name, str(folder)]) == 0
        file = assignment.work.split(":")[0]
        found = {path.name for path in folder.iterdir()}
        assert found == {"README.md", file, f"test_{file}", file.replace(".py", ".ipynb")}
        notebook = json.loads((folder / file.replace(".py", ".ipynb")).read_text())
        assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
        cells = notebook["cells"]
        assert [cell["cell_type"] for cell in cells] == ["markdown", "code", "code", "code"]
        assert len({cell["id"] for cell in cells}) == 4
        assert cells[1]["source"] == f"%%writefile {file}\n" + (folder / file).read_text()
    assert main(["assignment", "start", "swap", str(tmp_path / "swap")]) == 2
    assert "exists; name a new folder" in capsys.readouterr().err
    assert main(["assignment", "start", "swop"]) == 2
    assert "did you mean 'swap'?" in capsys.readouterr().err


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("controller", "swap", "learning")]


@pytest.mark.parametrize("name", ["distributed-mpc", "force-model", *SLOW])
def test_the_tests_that_students_are_given_pass(tmp_path, name):
    folder = tmp_path / name
    assert main(["assignment", "start", name, str(folder)]) == 0
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--assignment", "swap"], "--agent is empty"),
        (["--assignment", "force-model", "--agent", "a.py:A"], "needs it"),
        (["--assignment", "swap", "--agent", "a", "--limit-s", "0"], "must be positive"),
    ],
)
def test_what_cannot_be_graded_is_refused(arguments, why, refused):
    assert why in refused("grade", *arguments)


def test_data_that_cannot_grade_is_the_teachers_mistake(tmp_path, capsys):
    rows = wake_rows(40)
    damaged, unheld = tmp_path / "damaged.npz", tmp_path / "unheld.npz"
    damaged.write_text("hi", encoding="utf-8")
    save_rows(unheld, dataclasses.replace(rows, validation=np.zeros(40, dtype=np.bool_)))
    for path, why in (
        (tmp_path, "is the folder"),
        (tmp_path / "none.npz", "there is no such file"),
        (damaged, "cannot be read"),
        (unheld, "0 of 40 rows are for validation"),
    ):
        words = ["--assignment", "force-model", "--data", str(path), "--agent", "a.py:A"]
        assert main(["grade", *words]) == 2
        assert why in capsys.readouterr().err

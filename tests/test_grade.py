"""The command `grade`: points by known numbers, files that fail, and the starters of the course."""

from __future__ import annotations

import csv
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

from swarm_envs.assignments import ASSIGNMENTS, Learning, Swap
from swarm_envs.assignments.force import explained_share, grade_model
from swarm_envs.assignments.planner import (
    HORIZON,
    LEAST_DISTANCE,
    ROUND_S,
    draw_scenario,
    positions_of,
)
from swarm_envs.cli import main
from swarm_envs.grading import copies
from swarm_envs.grading.assignment import Assignment
from swarm_envs.grading.copies import copied_files
from swarm_envs.grading.grade import (
    Course,
    Grade,
    digest,
    episode_seeds,
    progress_file,
    student_ids,
    write_failure,
    write_results,
)
from swarm_envs.grading.sandbox import Sandbox, has_bubblewrap
from swarm_envs.grading.submission import Clock, Entry, WorkFailed, entered
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
from tests.helpers.users_agents import FINE
from tests.helpers.wake_rows import wake_rows

needs_bubblewrap = pytest.mark.skipif(not has_bubblewrap(), reason="bubblewrap is not installed")
GRADE = ["grade", f"--seed={(1 << 128) + 1}", *([] if has_bubblewrap() else ["--unprotected"])]
"""Several works are graded in any case."""
UNPROTECTED = Sandbox(unprotected=True)
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
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the assignments `swap` and `learning` have two drones and a second."""
    for kind in (Swap, Learning):
        monkeypatch.setattr(kind, "options", {"num_drones": 2, "horizon_s": 1.0})


@pytest.fixture
def work(tmp_path: Path, short: None) -> Path:
    """Return a file of works."""
    return written(tmp_path / "work.py", WORK)


def written(file: Path, text: str) -> Path:
    """Write a file, in a new folder if there is none."""
    file.parent.mkdir(exist_ok=True)
    file.write_text(text, encoding="utf-8")
    return file


def rows_of(table: Path) -> list[dict[str, str]]:
    """Return the rows of a table."""
    with table.open(newline="", encoding="utf-8") as file:
        return [*csv.DictReader(file)]


def grade(assignment: str | Path, *words: str | Path, episodes: int = 1) -> int:
    """Return what the command `grade` returns."""
    given = [*GRADE, "--assignment", assignment, "--episodes", episodes, *words]
    return main([*map(str, given)])


def test_points_rise_from_nothing_to_a_hundred():
    swap, controller = ASSIGNMENTS["swap"], ASSIGNMENTS["controller"]
    assert swap.points({"success_rate": 0.475}) == 50.0
    assert swap.points({"success_rate": 0.475, "counted": 0.8}) == 40.0
    assert swap.points({"success_rate": 0.0}) == 0.0
    assert controller.points({"worst_tracking_error_m": 0.055}) == 50.0  # less is better
    assert controller.points({"worst_tracking_error_m": 0.005}) == 100.0
    assert controller.points({"worst_tracking_error_m": None}) == 0.0
    assert not controller.counts({"success": False, "worst_tracking_error_m": 0.01})
    assert not controller.counts({"success": True, "worst_tracking_error_m": 0.2})


def test_files_that_fail_get_nothing_and_the_others_go_on(tmp_path, work, capsys):
    table, out = tmp_path / "grades.csv", tmp_path / "feedback"
    names = [f"{work}:{name}" for name in ("Nan", "Fine", "Missing", "Dies")]
    assert grade("swap", "--feedback", out, "--out", table, "--agent", *names) == 1
    assert capsys.readouterr().out.count("FAILED") == 3
    found = {line["work"].split(":")[-1]: line for line in rows_of(table)}
    assert [line["points"] for line in found.values()] == ["0.0"] * 4  # who hovers never arrives
    assert (found["Fine"]["success_rate"], found["Fine"]["error"]) == ("0.0", "")
    assert "must be finite" in found["Nan"]["error"]
    assert "unknown class or function 'Missing'" in found["Missing"]["error"]
    assert "exit code 3" in found["Dies"]["error"] and "%|" not in found["Dies"]["error"]
    bad, fine, *_ = sorted(out.iterdir())
    said = json.loads((fine / "results.json").read_text())
    assert (said["score"], said["max_score"]) == (0.0, 100.0)
    assert "success_rate: 0 gives 0 points" in said["output"]
    assert "<html" in (fine / "failure.html").read_text(encoding="utf-8")
    assert "must be finite" in json.loads((bad / "results.json").read_text())["output"]
    assert not (bad / "failure.html").exists()


def test_a_file_that_is_not_there_is_the_teacher_s_mistake(tmp_path, work, capsys):
    table, missing = tmp_path / "grades.csv", tmp_path / "none.py"
    assert grade("swap", "--out", table, "--agent", f"{work}:Fine", f"{missing}:Agent") == 2
    error = capsys.readouterr().err
    assert f"--agent names no existing file: {missing}; nothing was graded" in error
    assert str(work) not in error
    assert not table.exists()


def test_a_file_without_a_class_is_the_teacher_s_mistake(work, capsys):
    assert grade("swap", "--agent", work) == 2
    assert f"as '{work}:MyAgent'; nothing was graded" in capsys.readouterr().err


def test_files_that_are_none_are_not_looked_at(tmp_path, work, capsys):
    """A pipe without an end, a link to others' work, a source as large as a memory."""
    link, large, pipe = (tmp_path / part / "work.py" for part in ("link", "large", "pipe"))
    for file in (link, large, pipe):
        file.parent.mkdir()
    link.symlink_to(work)
    written(large, WORK + "X = [" + "1," * 2**20 + "]")
    os.mkfifo(pipe)
    assert grade("swap", "--agent", *(f"{file}:Fine" for file in (link, large, pipe))) == 1
    said = capsys.readouterr().out
    assert "FAILED: it or its folder is a symbolic link; submit the file itself" in said
    assert "FAILED: it is no regular file or folder" in said
    assert "bytes, but may have at most 1048576" in said


def test_weights_that_ship_are_known_and_what_is_no_file_is_left_out(tmp_path, work):
    os.mkfifo(tmp_path / "a.safetensors")
    (tmp_path / "b.safetensors").symlink_to("/dev/zero")
    (tmp_path / "c.safetensors").mkdir()
    with entered(f"{work}:Fine", "work.py:Fine", sandbox=UNPROTECTED, clock=Clock()) as entry:
        assert entry.work == "work.py:Fine"
        assert {path.name for path in entry.home.iterdir()} == {"work.py", "c.safetensors"}
        assert copied_files(entry.home, entry.work) == ""
        shipped = STARTERS.parent / "agents" / "weights" / "swap-dagger.safetensors"
        (entry.home / "e.safetensors").write_bytes(shipped.read_bytes())
        assert copied_files(entry.home, entry.work) == "swap-dagger"
    with entered(f"{work}:Fine", "swap.py:MyAgent", sandbox=UNPROTECTED, clock=Clock()) as entry:
        assert [path.name for path in entry.home.iterdir()] == ["work.py"]  # also alone in a run


def test_functions_in_others_are_compared_once(tmp_path):
    """Else a source of nested functions would take the grader's time."""
    depth, inner = 60, "x = [" + "1, " * 500 + "]"
    lines = [" " * k + f"def f{k}():" for k in range(depth)]
    file = written(tmp_path / "deep.py", "\n".join([*lines, " " * depth + inner]))
    (said,) = copies._functions(file)
    assert said.count("Constant") == 500


def interrupt_once_there(table: Path, ended: threading.Event) -> None:
    while not table.exists() and not ended.wait(0.1):
        pass
    if not ended.wait(0.5):
        os.kill(os.getpid(), signal.SIGINT)


def test_interrupted_the_table_has_who_was_graded(work, tmp_path, capsys):
    table = tmp_path / "grades.csv"
    names = [f"{work}:Nan", f"{work}:Sleeps", f"{work}:Fine"]
    words = ["--limit-s", "60", "--out", table, "--agent", *names]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # which xdist has put aside
    ended = threading.Event()
    watch = threading.Thread(target=interrupt_once_there, args=(table, ended))
    watch.start()
    try:
        assert grade("swap", *words) == 130
    finally:
        ended.set()
        watch.join()
        signal.signal(signal.SIGINT, before)
    shown = capsys.readouterr()
    assert "interrupted: 1 of 3 submissions are graded" in shown.err
    assert [row["work"] for row in rows_of(table)] == names[:1]
    kept = json.loads(progress_file(table).read_text())
    assert [grade["work"] for grade in kept["done"].values()] == names[:1]
    written(work, WORK.replace("time.sleep(1000)", "self.nothing"))
    assert grade("swap", *words) == 1
    assert [bool(row["error"]) for row in rows_of(table)] == [True, True, False]
    assert not progress_file(table).exists()


def test_a_grading_that_was_halted_goes_on_with_its_seed(work, tmp_path, capsys):
    table, names = tmp_path / "grades.csv", [f"{work}:Fine", f"{work}:Nan"]
    course = Course(ASSIGNMENTS["swap"], names, 1 << 128, 1, UNPROTECTED, out=table)
    assert next(course.grade()).error == ""
    kept = progress_file(table).read_text()
    progress_file(table).write_text(kept.replace('"points": 0.0', '"points": 12.5'))
    words = ["grade", "--assignment", "swap", "--episodes", "1", "--unprotected"]
    assert main([*words, "--out", str(table), "--agent", *names]) == 1
    assert f"to reproduce the grades: --seed {1 << 128}" in capsys.readouterr().out
    points = [row["points"] for row in rows_of(table)]
    assert points == ["12.5", "0.0"]  # the first was not graded again


def test_episodes_have_seeds_of_128_bits_and_more_begin_with_fewer():
    seeds = episode_seeds(1 << 128, 1000)
    assert len(set(seeds)) == 1000 and episode_seeds(1 << 128, 10) == seeds[:10]
    assert max(seeds) < 1 << 128 and sum(seed >> 127 for seed in seeds) > 400
    assert all(400 < sum(seed >> bit & 1 for seed in seeds) < 600 for bit in range(128))


@pytest.mark.parametrize(
    ("works", "ids"),
    [
        (["class/ann/swap.py:A", "class/bob/swap.py:A"], ["ann", "bob"]),
        (["class/ann.py:A", "class/bob.py:A"], ["ann", "bob"]),
        (["submitted/ann/ps1/a.py:A", "submitted/bob/ps1/a.py:A"], ["ann", "bob"]),
        (["class/ann.py:A", "class/bob/run"], ["ann", "bob"]),
        (["class/ann/swap.py:A"], ["ann"]),
    ],
)
def test_every_student_has_an_id_of_their_own(works, ids):
    assert student_ids(works) == ids


OWN = """
class MyAgent:
    requires, privileged = {'action': 'acceleration'}, False
    def reset(self, env, seed):
        assert len(env.possible_agents) == 4 and env.core.config.hall is not None
    def act(self, observations, view): return {name: [0.0] * 3 for name in observations}
"""


def own_assignment() -> str:
    """Return the assignment of the documentation, with a short time limit."""
    page = Path(__file__).parent.parent / "docs" / "assignments" / "own.md"
    code = page.read_text("utf-8").partition("```python\n")[2].partition("```")[0]
    return code.replace('"hall"}', '"hall", "horizon_s": 3.0}')


def graded_by_own(folder: Path, text: str, *words: str | Path) -> int:
    """Return what `grade` returns for an assignment of one's own."""
    mine, work = written(folder / "my.py", text), written(folder / "ann" / "rings.py", OWN)
    return grade(mine, *words, "--agent", f"{work}:MyAgent")


def test_an_assignment_of_one_s_own_is_a_class(tmp_path, capsys):
    table = tmp_path / "grades.csv"
    assert graded_by_own(tmp_path, own_assignment(), "--out", table) == 0, capsys.readouterr()
    (row,) = rows_of(table)
    assert float(row["rms_tracking_error_m"]) > 0.2 and row["points"] == "0.0"


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("class Rings(Assignment)", "class Rings", "defines 0 subclasses of Assignment"),
        ("zero, full = 0.20, 0.05", "", "Rings lacks zero, full; add them to the class"),
        ("0.20, 0.05", "0.05, 0.05", "zero and full are both 0.05"),
        ("num_drones", "num_dornes", "num_dornes"),
        ("ring_v1", "rong_v1", "rong_v1"),
    ],
)
def test_a_mistake_of_one_s_own_assignment_is_told_before_anything_is_graded(
    tmp_path, capsys, before, after, says
):
    assert graded_by_own(tmp_path, own_assignment().replace(before, after)) == 2
    shown = capsys.readouterr()
    assert says in shown.err and "FAILED" not in shown.out


def test_a_mistake_in_a_method_of_one_s_own_assignment_is_not_the_work_s(tmp_path, capsys):
    code = "    def counts(self, metrics):\n        return metrics['sucess']\n"
    assert graded_by_own(tmp_path, f"{own_assignment()}\n{code}") == 1
    assert "error of the assignment, not of the submission (line " in capsys.readouterr().out


def test_one_s_own_assignment_does_not_import_submissions(tmp_path, work, capsys):
    """A student's `scipy.py` beside it would run in the grader."""
    rings = written(tmp_path / "my.py", own_assignment())
    assert grade(rings, "--agent", f"{work}:Fine") == 2
    assert "submissions are in the same folder" in capsys.readouterr().err


def test_a_number_that_a_work_has_not_is_said(tmp_path):
    """Such as the median time to the goal of who never arrives."""
    write_results(tmp_path, ASSIGNMENTS["swap"], Grade("a.py:A", 0.0))
    assert "yours: -" in json.loads((tmp_path / "results.json").read_text())["output"]


def test_hidden_folders_of_a_work_count_nothing(tmp_path, work):
    (tmp_path / ".venv").mkdir()
    with (tmp_path / ".venv" / "large").open("wb") as file:
        file.truncate(1 << 30)
    with entered(f"{work}:Fine", "work.py:Fine", sandbox=UNPROTECTED, clock=Clock()) as entry:
        assert [path.name for path in entry.home.iterdir()] == ["work.py"]
    for number in range(5000):
        (tmp_path / f"{number}.txt").touch()
    with (
        pytest.raises(WorkFailed, match="too many files"),
        entered(f"{work}:Fine", "work.py:Fine", sandbox=UNPROTECTED, clock=Clock()),
    ):
        pass


def test_a_sandbox_that_starts_nothing_is_the_teacher_s_mistake(tmp_path, work, capsys):
    words = ["grade", "--assignment", "swap", "--agent", f"{work}:Fine"]
    for command in ("false", "no-such-program {work}"):
        assert main([*words, "--sandbox", command]) == 2
        shown = capsys.readouterr()
        assert "the sandbox starts no submission" in shown.err and "FAILED" not in shown.out


BESIDE = """
import pathlib, rules
from swarm_envs.agents.protocol import RowAgent
class Agent(RowAgent):
    requires = {'action': 'acceleration', 'decision_rate': 10}
    def reset(self, env, seed): import late
    def act_batch(self, rows):
        assert rules.WHOSE == WHOSE
        return rules.still(rows)
"""


def test_a_work_imports_what_lies_beside_it_wherever_it_is_flown(tmp_path, short):
    works = []
    for name in ("ann", "bob"):
        file = written(tmp_path / name / "swap.py", f"WHOSE = {name!r}{BESIDE}")
        rule = "import numpy as np\ndef still(rows): return np.zeros((*rows.shape[:-1], 3))\n"
        written(file.with_name("rules.py"), f"{rule}WHOSE = {name!r}")
        file.with_name("late.py").touch()
        works.append(f"{file}:Agent")
    assert grade("swap", "--agent", *works) == 0
    words = ["--drones", "2", "--horizon-s", "1", "--episodes", "2"]
    for work in works:
        assert main(["evaluate", *words, "--agent", work]) == 0


def test_a_pattern_names_the_whole_class(tmp_path, capsys):
    for student in ("ann", "bob"):
        written(tmp_path / student / "swap.py", "")
    assert grade("swap", "--agent", f"{tmp_path}/*/swap.py:Agent") == 1
    said = capsys.readouterr().out
    assert said.count("unknown class or function 'Agent'") == 2
    assert "ann/swap.py:Agent" in said and "bob/swap.py:Agent" in said
    assert grade("swap", "--agent", f"{tmp_path}/x*/swap.py:Agent") == 2
    assert "no file matches" in capsys.readouterr().err


def force_scores(work: str) -> dict[str, object]:
    """Return the scores of a model that is fitted to 300 rows, on 100 others."""
    rows, file = wake_rows(400), Path(work.rpartition(":")[0])
    fitted, held_out = rows.select(~rows.validation), rows.select(rows.validation)
    entry = Entry(work.removeprefix(f"{file.parent}/"), file.parent, UNPROTECTED, Clock())
    with entry.opened() as found:
        return grade_model(found[0], fitted, held_out, 3)


def test_a_force_model_is_scored_on_what_it_has_not_seen(work):
    held = wake_rows(400).select(wake_rows(400).validation)
    truth = modelled_force_g(held, "learned")[:, 2]
    mean = wake_rows(400).select(~wake_rows(400).validation).force_g[:, 2].mean()
    expected = explained_share(np.full(len(held), mean), truth)  # held-out labels are hidden
    assert force_scores(f"{work}:Sums") == {"explained": expected, "copied": ""}
    assert explained_share(np.zeros(len(held)), truth) == 0.0
    assert explained_share(truth, truth) == 1.0
    with pytest.raises(WorkFailed, match="must return 200 finite numbers"):
        force_scores(f"{work}:Short")
    with pytest.raises(WorkFailed, match="AttributeError"):
        force_scores(f"{work}:Fine")


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
    table = tmp_path / "grades.csv"
    works = [str(STARTERS / assignment / ASSIGNMENTS[assignment].work)]
    works += [f"{SOLUTIONS / file}:{name}" for name in (better, best)]
    words = ["--out", table, "--allow-copies", "--agent", *works]
    assert grade(assignment, *words, episodes=episodes) == 0
    first, second, third = (float(line["points"]) for line in rows_of(table))
    learned = assignment == "learning"  # there the starter learns already
    assert first > 0.0 if learned else first < 45.0
    assert first + (10.0 if learned else 2.0) < second < third - (5.0 if learned else 10.0)
    assert third > 75.0


LEARNER = """
'A learner.'
from __future__ import annotations
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
        assert self.__doc__ is None and 'hid' + 'den' not in pathlib.Path(__file__).read_text()
"""


def test_a_learner_is_trained_before_it_flies(tmp_path, capsys, short):
    names = "".join(f"name_of_weight_{k} = 0\n" for k in range(400))
    file = written(tmp_path / "learner.py", LEARNER)
    heavy = written(tmp_path / "heavy" / file.name, f"{LEARNER}WEIGHTS = {list(range(1000))}")
    named = written(tmp_path / "named" / file.name, LEARNER + names)
    (tmp_path / "weights").touch()
    works = [f"{file}:{name}" for name in ("Learner", "Hides", "Silent", "Remembers")]
    works += [f"{heavy}:Learner", f"{named}:Learner"]
    assert grade("learning", "--agent", *works) == 1
    said = capsys.readouterr().out
    assert said.count("FAILED") == 4
    assert "No such file" in said
    assert "its constants have" in said and "its different names have" in said


def test_a_controller_of_the_package_is_no_solution(tmp_path, capsys):
    code = WORK.replace("'decision_rate': 10}", "'controller': ControllerConfig()}")
    line = "from swarm_envs.control.config import ControllerConfig\n"
    file = written(tmp_path / "mine.py", line + code)
    assert grade("controller", "--agent", f"{file}:Fine") == 1
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
    file = written(tmp_path / "planner.py", PLANNER)
    words = ["--feedback", tmp_path / "feedback", "--out", tmp_path / "grades.json"]
    assert grade("distributed-mpc", *words, "--agent", f"{file}:Still", f"{file}:Strong") == 1
    said = capsys.readouterr().out
    rows = json.loads((tmp_path / "grades.json").read_text())
    assert [row["score"] for row in rows] == [0.0, 0.0]
    assert (rows[0]["assignment"], rows[0]["student_id"]) == ("distributed-mpc", tmp_path.name)
    (page,) = tmp_path.rglob("failure.html")  # of who flew
    assert "No success: the time limit was reached" in page.read_text("utf-8")
    assert re.search(r"planner.py:Still +0.0 +[0-9]+%  0\n", said)  # who stands still never arrives
    assert "accelerates by 6 m/s^2 on an axis, but must not exceed 5" in said


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


def test_a_page_of_an_earlier_failure_is_removed(tmp_path):
    (tmp_path / "failure.html").write_text("old", encoding="utf-8")
    write_failure(tmp_path, None)
    assert not (tmp_path / "failure.html").exists()


def test_assignments_are_listed_and_begun(tmp_path, capsys):
    assert main(["assignment", "list"]) == 0
    listed = capsys.readouterr().out
    assert all(f"\n{name} " in f"\n{listed}" for name in ASSIGNMENTS)
    for name, assignment in ASSIGNMENTS.items():
        assignment.check()  # also makes its environment
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


def test_a_metric_that_no_report_has_is_an_error_of_the_assignment():
    class Mine(Assignment):
        """Nothing."""

        name = "mine"
        metric = "rms_error"

    with pytest.raises(ValueError, match="unknown metric of assignment 'mine' 'rms_error'"):
        Mine().points({"rms_tracking_error_m": 0.1})


def test_a_huge_file_is_not_read_and_costs_one_work_alone(tmp_path):
    huge = tmp_path / "work.py"
    with huge.open("wb") as file:
        file.truncate(1 << 43)
    assert len(digest(f"{huge}:Work")) == 64

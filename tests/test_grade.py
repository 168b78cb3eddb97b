"""The command `grade`: points by known numbers, files that fail, and the starters of the course."""

from __future__ import annotations

import csv
import dataclasses
import os
import re
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.cli import main
from swarm_envs.commands.grade import ASSIGNMENTS
from swarm_envs.commands.grade_force import grade_model, score
from swarm_envs.commands.grading.remote import WorkFailed, opened
from swarm_envs.training.interaction_rows import save_rows
from tests.helpers.wake_rows import wake_rows

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="no groups of processes")
STARTERS = Path(__file__).parent.parent / "docs" / "assignments"

WORK = """
import os, pathlib, signal, subprocess, time
import numpy as np
class Fine:
    requires, privileged = {'action': 'acceleration', 'decision_rate': 10}, False
    def reset(self, env, seed): pass
    def act(self, observations, view):
        return {name: self.say() for name in observations}
    def say(self): return np.zeros(3, np.float32)
class Nan(Fine):
    def say(self): return np.full(3, np.nan)
class Dies(Fine):
    def say(self): os._exit(3)
class Hangs(Fine):
    def reset(self, env, seed):
        beats = pathlib.Path(__file__).with_suffix('.beats')
        subprocess.Popen(['sh', '-c', f'while :; do echo >> "{beats}"; sleep 0.05; done'])
    def say(self): time.sleep(1000)
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


@pytest.fixture
def work(tmp_path: Path) -> Path:
    file = tmp_path / "work.py"
    file.write_text(WORK, encoding="utf-8")
    return file


def test_points_rise_from_nothing_to_a_hundred():
    swap, controller = ASSIGNMENTS["swap"], ASSIGNMENTS["controller"]
    assert swap.points({"success_rate": 0.725}) == 50.0
    assert swap.points({"success_rate": 0.725, "collision_rate": 0.2}) == 40.0
    assert swap.points({"success_rate": 0.3}) == 0.0
    assert controller.points({"worst_height_error_m": 0.045}) == 50.0  # less is better
    assert controller.points({"worst_height_error_m": 0.005}) == 100.0
    assert controller.points({"worst_height_error_m": None}) == 0.0


def test_files_that_fail_get_nothing_and_the_others_go_on(tmp_path, work, capsys):
    table = tmp_path / "grades.csv"
    names = [f"{work}:{name}" for name in ("Nan", "Fine", "Missing", "Dies")]
    names.append(str(tmp_path / "none.py:Agent"))
    arguments = ["--episodes", "1", "--out", str(table)]
    assert main(["grade", "--assignment", "swap", *arguments, "--work", *names]) == 1
    with table.open(newline="") as file:
        found = {line["work"].split(":")[-1]: line for line in csv.DictReader(file)}
    assert [line["points"] for line in found.values()] == ["0.0"] * 5  # who hovers never arrives
    assert (found["Fine"]["success_rate"], found["Fine"]["error"]) == ("0.0", "")
    assert "must be finite" in found["Nan"]["error"]
    assert "unknown class 'Missing'" in found["Missing"]["error"]
    assert "there is no file" in found["Agent"]["error"]
    assert "exit code 3" in found["Dies"]["error"] and "%|" not in found["Dies"]["error"]
    assert capsys.readouterr().out.count("FAILED") == 4


def test_a_file_that_hangs_is_ended_and_the_next_goes_on(work, tmp_path, capsys):
    names = [f"{work}:Hangs", str(tmp_path / "none.py:Agent")]
    assert main(["grade", "--assignment", "swap", "--limit-s", "12", "--work", *names]) == 1
    said = capsys.readouterr().out
    assert re.search(r"work.py:Hangs +0.0 +FAILED: .*took longer than 12 s", said)
    assert said.count("FAILED") == 2
    beats = work.with_suffix(".beats")
    if beats.exists():  # it got so far in its time
        count = beats.stat().st_size
        time.sleep(0.5)
        assert beats.stat().st_size == count


def interrupt_once_there(table: Path) -> None:
    while not table.exists():
        time.sleep(0.1)
    time.sleep(0.5)
    os.kill(os.getpid(), signal.SIGINT)


def test_interrupted_the_table_has_who_was_graded(work, tmp_path, capsys):
    table = tmp_path / "grades.csv"
    names = [f"{work}:Sees", f"{work}:Sleeps", f"{work}:Fine"]
    arguments = ["--episodes", "1", "--limit-s", "60", "--out", str(table), "--work", *names]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # which xdist has put aside
    watch = threading.Thread(target=interrupt_once_there, args=(table,))
    watch.start()
    try:
        assert main(["grade", "--assignment", "swap", *arguments]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
        watch.join()
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
    assert main(["grade", "--assignment", "swap", "--work", pattern]) == 1
    said = capsys.readouterr().out
    assert said.count("unknown class 'Agent'") == 2
    assert "ann/swap.py:Agent" in said and "bob/swap.py:Agent" in said
    assert main(["grade", "--assignment", "swap", "--work", f"{tmp_path}/x*/swap.py:Agent"]) == 2
    assert "no file's name matches" in capsys.readouterr().err


def force_scores(work: str, data: Path) -> dict[str, float]:
    with opened(work, "fit") as (process, _):
        return grade_model(process, data)


def test_a_force_model_is_scored_on_what_it_has_not_seen(tmp_path, work):
    data = tmp_path / "rows.npz"
    save_rows(data, wake_rows(400))
    starter = force_scores(f"{STARTERS / 'force_model.py'}:MyModel", data)
    assert starter["explained"] == pytest.approx(1.0)  # its form is the truth here
    held = wake_rows(400).select(wake_rows(400).validation)
    mean = wake_rows(400).select(~wake_rows(400).validation).force_g[:, 2].mean()
    expected = score(np.full(len(held), mean), held)  # labels of held-out rows are hidden
    assert force_scores(f"{work}:Sums", data) == expected
    assert 0.0 < expected["explained"] < 1.0
    nothing = score(np.zeros(len(held)), held)
    assert nothing["explained"] == 0.0
    assert nothing["error_g"] == nothing["baseline_g"]
    with pytest.raises(ValueError, match="must give 100 finite numbers"):
        force_scores(f"{work}:Short", data)
    with pytest.raises(WorkFailed, match="AttributeError"):
        force_scores(f"{work}:Fine", data)


@pytest.mark.parametrize(
    ("assignment", "name", "least"),
    [("controller", "controller.py:MyController", 1.0), ("swap", "swap.py:MyAgent", 5.0)],
)
def test_starters_fly_and_leave_room(tmp_path, assignment, name, least):
    table = tmp_path / "grades.csv"
    arguments = ["--assignment", assignment, "--episodes", "24", "--out", str(table)]
    assert main(["grade", *arguments, "--work", str(STARTERS / name)]) == 0
    with table.open(newline="") as file:
        (line,) = csv.DictReader(file)
    assert least < float(line["points"]) < 90.0


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--assignment", "swap"], "--work is empty"),
        (["--assignment", "force-model", "--work", "a.py:A"], "needs it"),
        (["--assignment", "swap", "--work", "a", "--limit-s", "0"], "must be positive"),
    ],
)
def test_what_cannot_be_graded_is_refused(arguments, why, capsys):
    with pytest.raises(SystemExit) as end:
        main(["grade", *arguments])
    assert end.value.code == 2
    assert why in " ".join(capsys.readouterr().err.replace("│", " ").split())


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
        words = ["--assignment", "force-model", "--data", str(path), "--work", "a.py:A"]
        assert main(["grade", *words]) == 2
        assert why in capsys.readouterr().err

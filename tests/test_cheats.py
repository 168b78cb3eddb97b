"""Works that cheat: none gets points, nothing outlives it, and the next work is graded."""

from __future__ import annotations

import csv
import dataclasses
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save

import swarm_envs
from swarm_envs.agents import load
from swarm_envs.assignments import ASSIGNMENTS
from swarm_envs.cli import main
from swarm_envs.commands import grade
from swarm_envs.compiled import kernel_folder
from swarm_envs.training.interaction_rows import save_rows
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
from tests.helpers.wake_rows import wake_rows

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="confinement is Linux's")
if sys.platform == "linux":
    from swarm_envs.commands.grade_force import grade_model
    from swarm_envs.commands.grading import confinement, remote
    from swarm_envs.commands.grading.confinement import Protections
    from swarm_envs.commands.grading.copies import copied_acts, copied_forces
    from swarm_envs.commands.grading.grades import cell, printable
    from swarm_envs.commands.grading.messages import BadMessage, Channel, TooLate
    from swarm_envs.commands.grading.remote import opened

PACKAGE = Path(swarm_envs.__file__).parent
STARTERS = PACKAGE / "assignments"
SHORT_S = 10.0
MODES = {
    "all": lambda whole: whole,
    "namespaces": lambda whole: Protections(whole.unshare, 0),
    "Landlock": lambda whole: Protections((), whole.landlock),
    "another user": lambda whole: Protections((), 0, whole.user),
    "nothing": lambda whole: Protections((), 0),
}
"""What a system offers, by name, of all that this one does."""
ALONE = {
    "ends its parent": ("all", "namespaces", "Landlock", "another user"),
    "reads others' works and the environment": ("all", "namespaces", "Landlock"),
}
"""Cheats that only some of it keeps from harm."""

WORK = """
import atexit, ctypes, gc, json, multiprocessing, os, pathlib, resource, signal, socket
import struct, subprocess, sys, threading, time
import numpy as np
TABLE, RESULT, PACKAGE = {table!r}, {result!r}, {package!r}
class Agent:
    requires, privileged = {{'action': 'acceleration', 'decision_rate': 10}}, False
    def reset(self, env, seed): pass
    def act(self, observations, view):
        return {{name: np.zeros(3, np.float32) for name in observations}}
{cheat}
"""


def cheats_of(text: str) -> dict[str, tuple[str, str]]:
    """Cheats by what they do: code that follows that of `WORK`, and what the table says of it.

    Nothing if it flies on and gets nothing.
    """
    found = {}
    for part in text.split("# ")[1:]:
        head, _, code = part.partition("\n")
        name, _, says = head.partition(" | ")
        found[name] = code, says
    return found


CHEATS = cheats_of(r"""
# writes a report and ends | exit code 0
class Agent(Agent):
    def act(self, observations, view):
        json.dump({'agents': [{'success_rate': 1.0}]}, open('report.json', 'w'))
        os._exit(0)
# writes a report at its exit | SystemExit
atexit.register(lambda: print(json.dumps({'success_rate': 1.0})))
class Agent(Agent):
    def act(self, observations, view): sys.exit(0)
# looks for the judge's memory
class Agent(Agent):
    def act(self, observations, view):
        for thing in gc.get_objects():
            if type(thing).__name__ == 'SwarmCore' and thing.time.any():
                raise RuntimeError('found it')
        return super().act(observations, view)
# looks for what flies in the frames of its callers
class Agent(Agent):
    def reset(self, env, seed):
        assert not env.core.time.any()
        frame = sys._getframe()
        while frame is not None:
            for thing in list(frame.f_locals.values()):
                if 'seeds' in frame.f_locals or hasattr(thing, 'generate_state'):
                    raise RuntimeError('found it')
            frame = frame.f_back
# replaces the code that scores
from swarm_envs.agents import evaluation
def perfect(episodes): return {'success_rate': 1.0, 'collision_rate': 0.0}
evaluation.score_episodes.__code__ = perfect.__code__
evaluation.evaluate_agent.__code__ = perfect.__code__
# says that all episodes were flown before
for folder in (pathlib.Path(TABLE).parent, pathlib.Path('.')):
    try:
        (folder / 'report.episodes').mkdir()
        (folder / 'report.episodes' / 'x.jsonl').write_text('{"seed": 0}')
    except OSError: pass
# leaves a session that rewrites the table
SCRIPT = f"while :; do echo work,points > {TABLE}; echo eve,100 >> {TABLE}; sleep 0.1; done"
subprocess.Popen(['setsid', 'sh', '-c', SCRIPT])
# lies once of what it sees
class Agent(Agent):
    asked = 0
    @property
    def privileged(self):
        Agent.asked += 1
        return Agent.asked == 1
    def act(self, observations, view):
        assert view is None, 'it sees'
        return super().act(observations, view)
# leaves sixty-six sleepers
for _ in range(66): subprocess.Popen(['setsid', 'sleep', '1000'])
# leaves a daemon that forked twice
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(1000)
    os._exit(0)
# leaves threads running
def spin():
    while True: time.sleep(0.01)
for _ in range(8): threading.Thread(target=spin).start()
# forks until it may not
try:
    for _ in range(400):
        if os.fork() == 0: time.sleep(1000)
except OSError: pass
# ends its parent
for code in (signal.SIGINT, signal.SIGTERM):
    try: os.getppid() > 1 and os.kill(os.getppid(), code)
    except OSError: pass
# writes into the package
try:
    open(PACKAGE + '/errors.py', 'a').write('#')
except OSError: pass
# reads the grader's memory
try: open(f'/proc/{os.getppid()}/mem', 'rb').read(0)
except OSError: pass
else: raise RuntimeError('found it')
# reads the seed
for file in pathlib.Path('/proc').glob('[0-9]*/cmdline'):
    try: words = file.read_bytes()
    except OSError: continue
    if b'4711' in words: raise RuntimeError('found it')
# takes all cores
try: os.sched_setaffinity(0, range(1024))
except OSError: pass
if len(os.sched_getaffinity(0)) > 1: raise RuntimeError('found it')
# says something to others by locks, or hears what they open
import fcntl
file = os.open(__file__, os.O_RDONLY)
lock = struct.pack('hhqqi4x', fcntl.F_RDLCK, 0, 4711, 1, 0)
for call in (lambda: fcntl.flock(file, fcntl.LOCK_SH), lambda: fcntl.fcntl(file, 6, lock),
             lambda: fcntl.fcntl(file, 5, lock), lambda: fcntl.fcntl(file, 37, lock),
             lambda: fcntl.fcntl(file, 1026, 1)):
    try: call()
    except OSError: continue
    raise RuntimeError('found it')
if ctypes.CDLL(None).inotify_init1(0) >= 0: raise RuntimeError('found it')
# writes through ctypes
libc = ctypes.CDLL(None)
libc.ptrace(16, os.getppid(), 0, 0)
libc.prctl(4, 1, 0, 0, 0)
descriptor = libc.open(RESULT.encode(), 577, 0o644)
libc.write(descriptor, b'100', 3)
# answers in place of the process | nonsense
for descriptor in range(3, 64):
    try: os.write(descriptor, b'{"kind": "done", "success_rate": 1.0}')
    except OSError: pass
# answers with absurd lengths | nonsense
for descriptor in range(3, 64):
    try: os.write(descriptor, struct.pack('<4sII', b'SWRM', 2**32 - 1, 2**32 - 1))
    except OSError: pass
# answers with a thousand brackets | nonsense
for descriptor in range(3, 64):
    try: os.write(descriptor, struct.pack('<4sII', b'SWRM', 60000, 0) + b'[' * 60000)
    except OSError: pass
# claims a shape that it does not send | nonsense
HEAD = json.dumps({'kind': 'made', 'requires': {}, 'arrays': [['f8', [2**31, 2**31]]]})
for descriptor in range(3, 64):
    try: os.write(descriptor, struct.pack('<4sII', b'SWRM', len(HEAD), 0) + HEAD.encode())
    except OSError: pass
# gives a row of a million numbers | shape (1000000,)
class Agent(Agent):
    def act(self, observations, view):
        return {name: np.zeros(10**6) for name in observations}
# gives many rows of a million numbers
class Agent(Agent):
    def act(self, observations, view): return super().act(observations, view)
    def act_batch(self, rows): return np.zeros((10**3, 10**4))
# requires an easier task | unknown required option 'end_on_success'
Agent.requires = {**Agent.requires, 'end_on_success': False, 'horizon_s': 1e3}
# requires a million neighbours | must be at most 64
Agent.requires = {**Agent.requires, 'num_neighbors': 10000}
# requires what is no number | decision_rate
Agent.requires = {**Agent.requires, 'decision_rate': [[[[]]]]}
# raises words that forge a row | \x1b[2Jx\neve
class Agent(Agent):
    def act(self, observations, view):
        raise RuntimeError('\x1b[2Jx\neve  100.0  1.0\r\u202e' + 'x' * 10**6)
# allocates a hundred gigabytes | MemoryError
memory = np.ones(100 * 2**30 // 8)
# raises what cannot be said | Unsayable
class Unsayable(Exception):
    def __str__(self): raise SystemExit
class Agent(Agent):
    def act(self, observations, view): raise Unsayable
# calls the network
from contextlib import suppress
with suppress(OSError):
    socket.create_connection(('192.0.2.1', 80), 1.0)
    raise RuntimeError('connected')
# reads others' works and the environment
assert 'SECRET' not in os.environ
try: text = pathlib.Path(TABLE).parent.joinpath('bob', 'swap.py').read_text()
except OSError: pass
else: raise RuntimeError('found it')
""")
LONG = cheats_of(r"""
# sleeps for ever | took longer than 10 s
class Agent(Agent):
    def act(self, observations, view): time.sleep(10**6)
# answers byte by byte | took longer than 10 s
slow = struct.pack('<4sII', b'SWRM', 4096, 0) + b' ' * 4096
for k in range(4096):
    for descriptor in range(3, 16):
        try: os.write(descriptor, slow[k:k + 1])
        except OSError: pass
    time.sleep(0.2)
# writes 600 MB on stderr | exit code 7: =cmd|calc
for _ in range(600): os.write(2, b'x' * 2**20)
os.write(2, b'\n=cmd|calc\n')
os._exit(7)
# prints for ever | took longer than 10 s
while True: print('x' * 4096)
# fills the disk | OSError
with open('big', 'wb') as file:
    while True: file.write(b'x' * 2**20)
# forks for ever | took longer than 10 s
while True:
    try: os.fork()
    except OSError: time.sleep(0.01)
# stops itself | took longer
os.kill(os.getpid(), signal.SIGSTOP); time.sleep(100)
# waits for a second decision | longer than
class Agent(Agent):
    count = 0
    def act(self, observations, view):
        Agent.count += 1
        if Agent.count > 1: time.sleep(10**6)
        return super().act(observations, view)
# asks for the view for ever, and lets another read it | took longer than 10 s
import fcntl, stat
from safetensors.numpy import save
HEAD, NONE = b'{"kind": "view"}', save({})
ASK = (struct.pack('<4sII', b'SWRM', len(HEAD), len(NONE)) + HEAD + NONE) * 1000
def pipes(mode):
    return [n for n in range(3, 64) if isopen(n) and stat.S_ISFIFO(os.fstat(n).st_mode)
            and fcntl.fcntl(n, fcntl.F_GETFL) & os.O_ACCMODE == mode]
def isopen(n):
    try: return bool(os.fstat(n))
    except OSError: return False
def loop(call, descriptor, given):
    os.set_blocking(descriptor, True)
    while True: call(descriptor, given)
class Agent(Agent):
    def act(self, observations, view):
        if os.fork() == 0: loop(os.read, pipes(os.O_RDONLY)[0], 2**20)
        loop(os.write, pipes(os.O_WRONLY)[0], ASK)
""")
"""Cheats that last."""


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder that another user may read."""
    with tempfile.TemporaryDirectory() as made:
        Path(made).chmod(0o755)
        yield Path(made)


def written(folder: Path, cheats: dict[str, tuple[str, str]]) -> list[str]:
    """The works of a class: a cheat each, and last an honest one."""
    works = []
    for name, (code, _) in {**cheats, "bob": ("", "")}.items():
        file = folder / name.replace(" ", "-") / "swap.py"
        file.parent.mkdir(parents=True)
        names = {"table": folder / "grades.csv", "result": folder / "result.txt"}
        places = {key: str(place) for key, place in {**names, "package": PACKAGE}.items()}
        file.write_text(WORK.format(**places, cheat=code), encoding="utf-8")
        works.append(f"{file}:Agent")
    return works


GRADER = """
import sys
from swarm_envs.commands.grading import confinement
confinement.probe = lambda: confinement.Protections(*{offered!r})
from swarm_envs.cli import main
from swarm_envs.commands.grading import remote
{before}
sys.exit(main({words!r}))
"""


def offered(mode: str) -> Protections:
    """What a mode offers; the test is skipped where this system does not offer it."""
    found = MODES[mode](confinement.probe())
    if found.can_rename != (mode == "nothing"):
        pytest.skip(f"{mode}: not here")
    return found


def run_grader(
    mode: str, folder: Path, words: list[str], before: str = "", **environment: str
) -> subprocess.CompletedProcess[str]:
    """Grade in a process of its own, where nothing is imported yet; nothing may be left of it."""
    always = f"grade --seed 4711 --unprotected --out {folder / 'grades.csv'}".split()
    words = [*always, *words]
    code = GRADER.format(offered=tuple(offered(mode)), words=words, before=before)
    with confinement.guarded():  # orphans of the grader become children of this process
        found = confinement.descendants()
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            cwd=folder,  # or this tree's package would be found before a copy of it
            env={**os.environ, "SECRET": "42", **environment},
        )
        assert confinement.descendants() - found == set()
    return done


def check_class(
    mode: str, folder: Path, cheats: dict[str, tuple[str, str]], limit_s: float
) -> None:
    """Grade a class of cheats: none gets points, and the honest work is graded after them."""
    works, state = written(folder, cheats), remote.package_state()
    words = ["--assignment", "swap", "--episodes", "1", "--limit-s", str(limit_s)]
    done = run_grader(mode, folder, [*words, "--agent", *works])
    assert remote.package_state() == state
    result = folder / "result.txt"
    assert not result.exists() or not result.stat().st_size
    time.sleep(0.3)  # what is left would write now
    with (folder / "grades.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["work"] for row in rows] == works, done.stderr[-2000:]
    for row, (name, (_, says)) in zip(rows, [*cheats.items(), ("bob", ("", ""))], strict=True):
        assert row["points"] == "0.0", name
        assert says in row["error"] if says else not row["error"], (name, row["error"])
        assert len(row["error"]) <= 500 and "found it" not in row["error"] and not row["copied"]
    assert done.returncode == any(row["error"] for row in rows)


def test_some_cheats_get_nothing(folder):
    names = ("leaves a session that rewrites the table", "raises words that forge a row")
    check_class("all", folder, {name: CHEATS[name] for name in names}, 60.0)


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_no_cheat_gets_anything(folder, mode):
    fitting = {name: CHEATS[name] for name in CHEATS if mode in ALONE.get(name, MODES)}
    check_class(mode, folder, fitting, 60.0)
    assert len(fitting) >= 30


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["all", "nothing"])
def test_what_lasts_is_ended(folder, mode):
    check_class(mode, folder, LONG, SHORT_S)


REPLACES = """
import os, pathlib
import numpy as np
HERE = pathlib.Path(__file__).parent
for folder in {folders!r}:
    for file in sorted(pathlib.Path(folder).rglob('*.*')):
        if file.suffix in ('.py', '.nbi', '.nbc', '.json', '.safetensors'):
            try:
                os.link(HERE / 'evil.py', HERE / 'evil')
                os.replace(HERE / 'evil', file)
            except OSError: pass
class Mean:
    def fit(self, rows): pass
    def predict(self, rows): return np.zeros(len(rows.force_g))
"""
EVIL = "open({result!r}, 'a').write('imported'); raise RuntimeError('found it')"


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_files_that_a_work_replaces_are_not_read(folder, mode):
    """In a copy of the package, with kernels of its own."""
    copy, kernels, work = (folder / name for name in ("copy", "kernels", "eve"))
    shutil.copytree(PACKAGE, copy / "swarm_envs", ignore=shutil.ignore_patterns("__pycache__"))
    work.mkdir()
    replaces = REPLACES.format(folders=[str(copy), str(kernels)])
    (work / "model.py").write_text(replaces, encoding="utf-8")
    evil = EVIL.format(result=str(folder / "result.txt"))
    (work / "evil.py").write_text(evil, encoding="utf-8")
    save_rows(folder / "rows.npz", wake_rows(400))
    words = ["--assignment", "force-model", "--data", str(folder / "rows.npz")]
    words += ["--feedback", str(folder / "out"), "--agent", f"{work / 'model.py'}:Mean"]
    paths = {"PYTHONPATH": str(copy), "NUMBA_CACHE_DIR": str(kernels)}
    done = run_grader(mode, folder, words, **paths)
    result = folder / "result.txt"  # the work itself can make it, and write nothing into it
    assert not result.exists() or not result.read_text(), done.stderr
    files = [file for file in [*copy.rglob("*.*"), *kernels.rglob("*.*")] if file.is_file()]
    replaced = [file for file in files if file.read_bytes() == evil.encode()]
    if mode == "nothing":
        assert len(replaced) > 100 and (done.returncode, "changed" in done.stderr) == (2, True)
        assert not (folder / "grades.csv").exists()
    else:
        assert not replaced and done.returncode == 0, done.stderr


WATCH = """
begun, files_of, late = [], remote.files_of, []
def watched(name, *given):
    if name.startswith({folder!r}): begun.append(name)
    return files_of(name, *given)
remote.files_of, remote.package_state = watched, dict
roots = tuple(map(str, {roots!r}))
def hook(event, given):
    if begun and (event == "import" or event == "open" and str(given[0]).startswith(roots)):
        if not str(given[0]).endswith(".py"): late.append(str(given[0]))  # a source is text
sys.addaudithook(hook)
import atexit
atexit.register(lambda: open({late!r}, "w").write(str(late)))
"""


SLOW = [pytest.param(n, marks=pytest.mark.slow) for n in ("swap", "controller", "distributed-mpc")]


@pytest.mark.parametrize("assignment", ["force-model", *SLOW])
def test_the_grader_reads_nothing_once_a_work_could_have_replaced_it(tmp_path, assignment):
    """No module, weights, kernel or page of the package, of Python and of what is installed."""
    roots = [*PACKAGE.parent.glob("*"), kernel_folder(), sys.prefix, sys.base_prefix]
    places = {"late": str(tmp_path / "late"), "folder": str(tmp_path)}
    before = WATCH.format(roots=[str(each) for each in roots], **places)
    shutil.copytree(STARTERS / assignment, tmp_path / "work")
    work = tmp_path / "work" / ASSIGNMENTS[assignment].work
    words = ["--assignment", assignment, "--episodes", "20", "--agent", str(work)]
    if assignment == "force-model":
        save_rows(tmp_path / "rows.npz", wake_rows(400))
        words += ["--data", str(tmp_path / "rows.npz")]
    done = run_grader("nothing", tmp_path, [*words, "--feedback", str(tmp_path / "out")], before)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "late").read_text() == "[]"


PEEKS = """
import gc, sys
import numpy as np
class Peeks:
    def fit(self, rows): self.mean = rows.force_g[:, 2].mean()
    def predict(self, rows):
        found, frame = rows.force_g[:, 2], sys._getframe()
        while frame is not None:
            for thing in [*frame.f_locals.values(), *gc.get_objects()]:
                force = vars(thing).get('force_g') if type(thing) is type(rows) else None
                if force is not None and len(force) == len(found) and force.any():
                    found = force[:, 2]
            frame = frame.f_back
        return found
class Mean(Peeks):
    def predict(self, rows): return np.zeros(len(rows.force_g))
"""


def test_held_out_labels_are_nowhere_in_the_process_of_a_model(tmp_path):
    data, work = tmp_path / "rows.npz", tmp_path / "work.py"
    save_rows(data, wake_rows(400))
    work.write_text(PEEKS, encoding="utf-8")
    scores = {}
    for name in ("Peeks", "Mean"):
        with opened(f"{work}:{name}", "fit") as (process, _):
            scores[name] = grade_model(process, data)
    assert scores["Peeks"] == scores["Mean"]


STOLEN = """
import numpy as np
from swarm_envs import agents
from swarm_envs.agents import load
class Agent:
    def __init__(self):
        self.own = load('swap-dagger')
        self.requires, self.privileged = dict(self.own.requires), False
    def reset(self, env, seed): self.own.reset(env, seed)
    def act(self, observations, view):
        return {n: 0.97 * a for n, a in self.own.act(observations, view).items()}
class Line(Agent):
    def __init__(self):
        self.requires, self.privileged = {'action': 'acceleration', 'decision_rate': 10}, False
    def reset(self, env, seed):
        at = {field.name: field.where for field in env.observation_layout}
        self.goal, self.velocity = at['task.goal'], at['self.velocity']
    def act(self, observations, view):
        return {n: self.fly(row) for n, row in observations.items()}
    def fly(self, row):
        return np.clip(1.5 * row[self.goal] - 1.2 * row[self.velocity], -1, 1).astype(np.float32)
class Behind(Agent):
    def __init__(self):
        self.own = getattr(agents, 'Safety' + 'Filter')(Line())
        self.requires, self.privileged = dict(self.own.requires), False
    def act(self, observations, view): return self.own.act(observations, view)
class Peeks(Agent):
    def __init__(self):
        super().__init__()
        self.requires = {'action': 'acceleration', 'decision_rate': 10}
    def reset(self, env, seed): self.env = env
    def act(self, observations, view):
        view = self.env.view
        assert np.allclose(view.reference(view.time).position, view.goals)
        asked = 1.5 * (view.goals - view.state.position) - 1.2 * view.state.velocity
        return dict(zip(observations, np.clip(asked / 5.0, -1.0, 1.0)))
"""


def test_what_ships_and_who_looks_at_the_truth_is_starred(monkeypatch, tmp_path, capsys):
    four = {"task": "swap", "layout": "random", "drones": 4}
    swap = dataclasses.replace(ASSIGNMENTS["swap"], flown=four)
    monkeypatch.setattr(grade, "ASSIGNMENTS", {"swap": swap})
    work, table, stolen = tmp_path / "swap.py", tmp_path / "grades.csv", tmp_path / "weights"
    work.write_text(STOLEN, encoding="utf-8")
    stolen.mkdir()
    shipped = PACKAGE / "agents" / "weights" / "swap-dagger.safetensors"
    (stolen / "policy.safetensors").write_bytes(shipped.read_bytes())
    source = tmp_path / "line" / "swap.py"
    source.parent.mkdir()
    scripted = (PACKAGE / "agents" / "scripted.py").read_text(encoding="utf-8")
    source.write_text(scripted.replace("class StraightLineAgent", "class Mine"), encoding="utf-8")
    starter = tmp_path / "starter" / "swap.py"
    starter.parent.mkdir()
    starter.write_bytes((STARTERS / "swap" / "swap.py").read_bytes())
    works = [*(f"{work}:{name}" for name in ("Agent", "Behind", "Peeks")), str(stolen)]
    works += [f"{source}:Mine", f"{starter}:MyAgent"]
    words = ["--episodes", "2", "--out", str(table), "--agent", *works]
    assert main(["grade", "--assignment", "swap", *words]) == 0
    with table.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["copied"] for row in rows] == [
        *("swap-dagger", "an agent behind SafetyFilter", ""),
        *("swap-dagger", "StraightLineAgent", ""),
    ]
    assert [row["privileged"] == "True" for row in rows] == [
        name.endswith("Peeks") for name in works
    ]
    assert "flies as swap-dagger" in capsys.readouterr().out


def _decisions(law, agent="swap-dagger", seeds=(0, 1)):
    """Rows and actions of flights of four by a law of rows (N, width) and the observed fields."""
    requires = {**load(agent).requires, "physics": "batch"}
    env = swarm_envs.swap_v1.parallel_env(num_drones=4, layout="random", **requires)
    where, kept = {field.name: field.where for field in env.observation_layout}, []
    for seed in seeds:
        observations, _ = env.reset(seed=seed)
        while env.agents:
            rows = np.stack([*observations.values()])
            kept.append((rows, np.clip(law(rows, where), -1.0, 1.0)))
            acts = kept[-1][1].astype(np.float32)
            observations, *_ = env.step(dict(zip(env.agents, acts)))
    return env, kept


@pytest.mark.parametrize("name", ["swap-dagger", "swap-dagger+filter"])
@pytest.mark.parametrize("factor", [1.0, 0.8])
def test_what_ships_is_known_by_its_acts(name, factor):
    agent: Any = load(name)
    agent.reset(swarm_envs.swap_v1.parallel_env(num_drones=4, **agent.requires), 0)
    env, kept = _decisions(lambda rows, _: factor * agent.act_batch(rows[None])[0], name)
    assert copied_acts(env, kept).removesuffix("+filter") == "swap-dagger"


def test_a_shipped_force_model_is_known_by_what_it_predicts():
    rows = wake_rows(400)
    own = modelled_force_g(rows, "learned")[:, 2]
    noise = np.random.default_rng(0).normal(size=len(rows))
    for disguised in (own, 0.8 * own + 0.1, own + 0.02 * own.std() * noise):
        assert copied_forces(disguised, rows) == "learned"
    for honest in (np.zeros(len(rows)), noise, own + 0.4 * own.std() * noise):
        assert copied_forces(honest, rows) == ""


@pytest.mark.parametrize(("stiffness", "damping"), [(2.0, 2.0), (4.0, 3.0), (8.0, 5.0)])
def test_a_law_of_one_s_own_is_nobody_s_copy(stiffness, damping):
    def law(rows, where):
        return (
            stiffness * rows[:, where["self.setpoint_offset"]]
            - damping * rows[:, where["self.velocity"]]
        ) / 5.0

    env, kept = _decisions(law)
    assert copied_acts(env, kept) == ""


UNTRAINED = """
import importlib
class Untrained(importlib.import_module('swarm_envs.assignments.learning.learner').MyLearner):
    def train(self, seconds): pass
"""


@pytest.mark.parametrize(
    ("assignment", "task", "episodes"),
    [
        ("swap", ["--layout", "random", "--team", "SSSSSSSSLLLLLLLL"], "80"),
        ("controller", ["--layout", "stacked", "--drones", "3", "--world", "hall"], "4"),
        ("learning", ["--layout", "random", "--drones", "8"], "80"),
    ],
)
def test_honest_works_get_the_mark_of_evaluate(tmp_path, assignment, task, episodes):
    table, report, file = tmp_path / "grades.csv", tmp_path / "report.json", tmp_path / "work.py"
    file.write_text(UNTRAINED, encoding="utf-8")  # evaluate trains nobody
    work = f"{STARTERS / assignment / ASSIGNMENTS[assignment].work}"
    work = f"{file}:Untrained" if assignment == "learning" else work
    common = ["--episodes", episodes, "--seed", "7"]
    main(["grade", "--assignment", assignment, *common, "--out", str(table), "--agent", work])
    main(["evaluate", "--task", "swap", *task, *common, "--json", str(report), "--agent", work])
    expected = json.loads(report.read_text(encoding="utf-8"))
    with table.open(newline="", encoding="utf-8") as lines:
        (row,) = csv.DictReader(lines)
    metric = ASSIGNMENTS[assignment].metric
    assert float(row[metric]) == expected[metric]
    assert float(row["points"]) == ASSIGNMENTS[assignment].points(expected)


def test_what_is_missing_is_said(monkeypatch, tmp_path, capsys):
    bare = Protections((), 0)
    monkeypatch.setattr(confinement, "probe", lambda: bare)
    assert main(["grade", "--assignment", "swap", "--agent", str(tmp_path / "none.py:Agent")]) == 2
    said = capsys.readouterr()
    assert all(missing in said.out for missing in bare.missing)
    assert said.out.count("a work is not confined as it should be") == len(bare.missing) >= 4
    assert "add --unprotected in a container of its own" in said.err
    whole = Protections(("unshare", "--pid"), 7)
    monkeypatch.setattr(confinement, "_pids_can_be_few", lambda: True)
    assert whole.missing == []


def test_cells_are_no_formulas_and_words_stay_on_their_line():
    assert [cell(words) for words in ("=1", "+1", "-1", "@a", "\ta", "a=1")] == [
        *("'=1", "'+1", "'-1", "'@a", "'\ta", "a=1")
    ]
    assert printable("a\n\x1b\u202e\u2028é") == "a\\n\\x1b\\u202e\\u2028é"
    assert len(printable("x" * 10**6)) == 500


def test_a_message_that_is_not_what_it_says_is_refused():
    source, sink = os.pipe()
    channel = Channel(source, sink)
    numbers = np.arange(6, dtype=np.float32).reshape(2, 3)
    channel.send({"kind": "rows", "x": 1}, [numbers, numbers > 2])
    with pytest.raises(TooLate):  # although it is there: who sends without a pause ends too
        channel.receive(until=time.monotonic() - 1.0)
    header, arrays = channel.receive()
    assert header["x"] == 1
    np.testing.assert_array_equal(arrays[0], numbers)
    np.testing.assert_array_equal(arrays[1], numbers > 2)
    sent = save({"0": numbers})
    for wrong in (
        sent[:-1],
        sent + b"1",
        sent.replace(b"F32", b"F99"),
        save({"1": numbers}),
        b"1234",
    ):
        os.write(sink, struct.pack("<4sII", b"SWRM", 12, len(wrong)) + b'{"kind":"x"}' + wrong)
        with pytest.raises(BadMessage):
            channel.receive()
    os.close(source)
    os.close(sink)

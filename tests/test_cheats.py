"""Works that cheat: none gets points, nothing outlives it, and the next work is graded."""

from __future__ import annotations

import csv
import importlib
import io
import os
import shutil
import subprocess
import sys
import time
import zlib
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import swarm_envs
from swarm_envs.agents import load
from swarm_envs.agents.evaluation import evaluate_agent, score_episodes
from swarm_envs.agents.registry import load_agent
from swarm_envs.assignments import ASSIGNMENTS, Learning, Swap, force
from swarm_envs.assignments.force import copied_forces, exchanged
from swarm_envs.cli import main
from swarm_envs.grading import assignment as grading
from swarm_envs.grading import sandbox
from swarm_envs.grading.assignment import Assignment, load_assignment
from swarm_envs.grading.copies import SOLUTIONS, copied_acts, copied_files
from swarm_envs.grading.grade import Course, Grade, cell, episode_seeds
from swarm_envs.grading.groups import ControlGroup
from swarm_envs.grading.pipes import BadMessage, receive, send
from swarm_envs.grading.sandbox import Sandbox, has_bubblewrap
from swarm_envs.grading.submission import printable
from swarm_envs.training.interaction_rows import save_rows
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
from tests.helpers.wake_rows import wake_rows

needs_bubblewrap = pytest.mark.skipif(not has_bubblewrap(), reason="bubblewrap is not installed")
PACKAGE = Path(swarm_envs.__file__).parent
STARTERS = PACKAGE / "assignments"
SHIPPED = PACKAGE / "agents" / "weights" / "swap-dagger.safetensors"
SEED = (1 << 128) + 4711
SANDBOX = Sandbox(unprotected=not has_bubblewrap())

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
        json.dump({'agents': [{'success_rate': 1.0}]}, open('/tmp/report.json', 'w'))
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
# requires the true state | requires the true state
Agent.privileged = True
# lies of what it sees | requires the true state
class Agent(Agent):
    asked = 0
    @property
    def privileged(self):
        Agent.asked += 1
        return Agent.asked == 2
    def act(self, observations, view):
        if view is not None: raise RuntimeError('found it')
        return super().act(observations, view)
# looks at the true state of its environment | part of the true state
class Agent(Agent):
    def reset(self, env, seed): self.env = env
    def act(self, observations, view):
        return dict(zip(observations, self.env.view.goals))
# looks for its episode among the seeds of the documentation
class Agent(Agent):
    def reset(self, env, seed): self.env = env
    def act(self, observations, view):
        from swarm_envs.agents.evaluation import frozen_seeds
        from swarm_envs.grading.grade import episode_seeds
        for seed in (0, 1, 7, 4711):
            for flown in (*frozen_seeds(seed, 4), *episode_seeds(seed, 4), seed):
                rows, _ = self.env.reset(seed=flown)
                own = np.stack([*observations.values()])
                if np.array_equal(np.stack([*rows.values()]), own): raise RuntimeError('found it')
        return super().act(observations, view)
# reads a file of the system into its error | No such file
raise RuntimeError(open('/etc/shadow').read())
# talks through the memory of the machine | No such file
open('/proc/meminfo').read()
# imports a neighbour's file | No module named 'bob'
sys.path += [str(pathlib.Path(TABLE).parent / 'bob'), '..']
import bob
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
for _ in range(2 * (os.cpu_count() or 1)):
    if os.fork() == 0:
        while True: pass
# says something to others by locks, or hears what they open
import fcntl
file = os.open(__file__, os.O_RDONLY)
lock = struct.pack('hhqqi4x', fcntl.F_RDLCK, 0, 4711, 1, 0)
for call in (lambda: fcntl.flock(file, fcntl.LOCK_SH), lambda: fcntl.fcntl(file, 6, lock),
             lambda: fcntl.fcntl(file, 5, lock), lambda: fcntl.fcntl(file, 37, lock),
             lambda: fcntl.fcntl(file, 1026, 1)):
    try: call()
    except OSError: continue
ctypes.CDLL(None).inotify_init1(0)
# writes through ctypes
libc = ctypes.CDLL(None)
libc.ptrace(16, os.getppid(), 0, 0)
libc.prctl(4, 1, 0, 0, 0)
descriptor = libc.open(RESULT.encode(), 577, 0o644)
libc.write(descriptor, b'100', 3)
# answers in place of the process | gave an invalid answer
for descriptor in range(3, 64):
    try: os.write(descriptor, b'{"kind": "done", "success_rate": 1.0}')
    except OSError: pass
# answers with absurd lengths | gave an invalid answer
for descriptor in range(3, 64):
    try: os.write(descriptor, struct.pack('<4sIQ', b'SWRM', 2**32 - 1, 2**32 - 1))
    except OSError: pass
# answers with a thousand brackets | gave an invalid answer
for descriptor in range(3, 64):
    try: os.write(descriptor, struct.pack('<4sIQ', b'SWRM', 60000, 0) + b'[' * 60000)
    except OSError: pass
# claims a shape that it does not send | gave an invalid answer
HEAD = json.dumps({'0': {'dtype': 'F64', 'shape': [2**31, 2**31], 'data_offsets': [0, 8]}})
SENT = struct.pack('<Q', len(HEAD)) + HEAD.encode() + bytes(8)
SAID = b'{"kind": "made", "requires": {}}'
for descriptor in range(3, 64):
    try: os.write(descriptor, struct.pack('<4sIQ', b'SWRM', len(SAID), len(SENT)) + SAID + SENT)
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
# requires a million neighbours | must be an integer of at least 0 and at most 64
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
slow = struct.pack('<4sIQ', b'SWRM', 4096, 0) + b' ' * 4096
for k in range(4096):
    for descriptor in range(3, 16):
        try: os.write(descriptor, slow[k:k + 1])
        except OSError: pass
    time.sleep(0.2)
# writes 600 MB on stderr | File too large
for _ in range(600): os.write(2, b'x' * 2**20)
# ends with a formula | exit code 7: =cmd|calc
os.write(2, b'\n=cmd|calc\n')
os._exit(7)
# prints for ever | File too large
while True: print('x' * 4096)
# fills the disk | OSError
with open('/tmp/big', 'wb') as file:
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
# answers for ever before it is asked | gave an invalid answer
import fcntl, stat
from safetensors.numpy import save
HEAD, NONE = b'{"kind": "answer"}', save({})
def isopen(n):
    try: return bool(os.fstat(n))
    except OSError: return False
pipes = [n for n in range(3, 64) if isopen(n) and stat.S_ISFIFO(os.fstat(n).st_mode)
         and fcntl.fcntl(n, fcntl.F_GETFL) & os.O_ACCMODE == os.O_WRONLY]
def answer():
    sent = struct.pack('<4sIQ', b'SWRM', len(HEAD), len(NONE)) + HEAD + NONE
    while True: os.write(pipes[0], sent)
class Agent(Agent):
    def reset(self, env, seed): threading.Thread(target=answer, daemon=True).start()
""")
"""Cheats that last."""
SHORT = """
from swarm_envs.assignments import Swap
class Short(Swap):
    options = {'layout': 'random', 'num_drones': 4, 'horizon_s': 2.0}
"""


def written(folder: Path, cheats: dict[str, tuple[str, str]]) -> list[str]:
    """Write the works of a class, a cheat each, and last an honest one; return their names."""
    works = []
    for name, (code, _) in {**cheats, "bob": ("", "")}.items():
        places = {"table": folder / "grades.csv", "result": folder / "result.txt"}
        words = {key: str(place) for key, place in {**places, "package": PACKAGE}.items()}
        file = folder / name.replace(" ", "-") / "swap.py"
        file.parent.mkdir()
        file.write_text(WORK.format(**words, cheat=code), encoding="utf-8")
        works.append(f"{file}:Agent")
    return works


def running() -> set[str]:
    """Processes of works, and control groups that still have processes, by their paths."""
    found = set()
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = file.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if "swarm_envs.grading.work" in line or "sleep 1000" in line:
            found.add(str(file))
    return found | {str(group) for group in Path("/sys/fs/cgroup").glob("*/swarm-envs-*-*")}


def left_behind(before: set[str]) -> set[str]:
    """Return what began since then, but for works of other workers' tests: these have parents."""
    beside = os.getppid() if "PYTEST_XDIST_WORKER" in os.environ else -1
    found = {place: ancestors(place) for place in running() - before}
    return {place for place, up in found.items() if os.getpid() in up or beside not in up}


def ancestors(place: str) -> set[int]:
    """Return the numbers of a process's parents, by its place in /proc; none of a control group."""
    found, number = set[int](), Path(place).parent.name
    while number.isdigit() and int(number) > 1:
        try:
            number = Path("/proc", number, "stat").read_text().rpartition(")")[2].split()[1]
        except OSError:
            break
        found.add(int(number))
    return found


def check_class(folder: Path, cheats: dict[str, tuple[str, str]], limit_s: float) -> None:
    """Grade a class of cheats: none gets points, and the honest work is graded after them."""
    works, before = written(folder, cheats), running()
    short, table = str(file_of(folder, "short", SHORT)), str(folder / "grades.csv")
    words = ["grade", "--assignment", short, "--episodes", "1", "--limit-s", str(limit_s)]
    words += ["--seed", str(SEED), "--out", table, "--agent", *works]
    done = subprocess.run(
        [sys.executable, "-m", "swarm_envs", *words],
        capture_output=True,
        text=True,
        env={**os.environ, "SECRET": "42"},
    )
    assert not (folder / "result.txt").exists()
    time.sleep(0.3)  # what is left would write now
    assert not left_behind(before)
    with (folder / "grades.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["work"] for row in rows] == works, done.stderr[-2000:]
    for row, (name, (_, says)) in zip(rows, [*cheats.items(), ("bob", ("", ""))], strict=True):
        assert row["points"] == "0.0", name
        assert says in row["error"] if says else not row["error"], (name, row["error"])
        assert len(row["error"]) <= 500 and "found it" not in row["error"] and not row["copied"]
    assert done.returncode == any(row["error"] for row in rows)


@needs_bubblewrap
def test_some_cheats_get_nothing(tmp_path):
    names = ("leaves a session that rewrites the table", "raises words that forge a row")
    check_class(tmp_path, {name: CHEATS[name] for name in names}, 60.0)


@needs_bubblewrap
@pytest.mark.slow
def test_no_cheat_gets_anything(tmp_path):
    assert len(CHEATS) >= 31
    check_class(tmp_path, CHEATS, 60.0)


@needs_bubblewrap
@pytest.mark.slow
def test_what_lasts_is_ended(tmp_path):
    check_class(tmp_path, LONG, 10.0)


def can_group() -> bool:
    """Return True if the system lets control groups be made."""
    group = ControlGroup(1 << 30)
    group.remove()
    return bool(group.words)


def graded(assignment: Assignment, *works: str, episodes: int = 2, **how: Any) -> list[Grade]:
    """Grade works in this process."""
    given: dict[str, Any] = {"sandbox": SANDBOX, **how}
    return [*Course(assignment, [*works], SEED, episodes, **given).grade()]


def file_of(folder: Path, name: str, *code: str) -> Path:
    """A file with code, in a folder of its own."""
    file = folder / name / f"{name}.py"
    file.parent.mkdir(parents=True)
    file.write_text("\n".join(code), encoding="utf-8")
    return file


FLYER = """
import pathlib, tempfile, zlib
import numpy as np
from swarm_envs import agents
from swarm_envs.agents import load
class Agent:
    requires, privileged = {'action': 'acceleration', 'decision_rate': 10}, False
    def reset(self, env, seed):
        self.at = {field.name: field.where for field in env.observation_layout}
    def act(self, observations, view):
        return {n: self.fly(row) for n, row in observations.items()}
    def fly(self, row):
        goal, velocity = row[self.at['task.goal']], row[self.at['self.velocity']]
        return np.clip(1.5 * goal - 1.2 * velocity, -1, 1).astype(np.float32)
class Alone(Agent):
    requires = {**Agent.requires, 'num_neighbors': 0}
class Loads(Agent):
    def __init__(self): load('swap-dagger')
class Stolen(Agent):
    'Brings the weights along, in a file that no digest knows.'
    asked = {}
    def __init__(self):
        file = pathlib.Path(tempfile.mkdtemp(), 'policy.safetensors')
        file.write_bytes(zlib.decompress(pathlib.Path(__file__).with_name('net').read_bytes()))
        self.own = load(str(file))
        self.requires = {**self.own.requires, **self.asked}
    def reset(self, env, seed):
        from swarm_envs.envs.observation import observation_layout
        self.layout, self.rng = env.observation_layout, np.random.default_rng(0)
        self.known = observation_layout(*self.own.policy.note.form)
    def act(self, observations, view):
        rows = np.stack([*observations.values()])
        found = np.zeros((len(rows), self.known[-1].where.stop), np.float32)
        places = {field.name: field.where for field in self.layout}
        for field in self.known:
            name = field.name if field.name in places else 'self.velocity'  # of its set-point
            found[:, field.where] = rows[:, places[name]]
        return dict(zip(observations, map(self.turn, self.own.act_batch(found))))
    def turn(self, a): return 0.97 * a
class Wide(Stolen): asked = {'num_neighbors': 15, 'observe_load': True}
class Blind(Stolen): asked = {'observe_setpoint': False}
class Noisy(Stolen):
    def turn(self, a): return np.clip(a + self.rng.normal(0.0, 0.25, 3), -1, 1)
class Turned(Stolen):
    def turn(self, a):
        c, s = np.cos(np.radians(8)), np.sin(np.radians(8))
        return np.clip(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ a, -1, 1)
class Waves(Stolen):
    def turn(self, a): return np.clip(a + 0.05 * np.sin(20 * a[::-1]), -1, 1)
class Behind(Agent):
    def __init__(self): self.own = getattr(agents, 'Safety' + 'Filter')(Agent())
    def reset(self, env, seed): self.own.reset(env, seed)
    def act(self, observations, view): return self.own.act(observations, view)
"""


class Four(Swap):
    """Swap with four drones."""

    options: ClassVar[Mapping[str, Any]] = {"layout": "random", "num_drones": 4}


def evaluated(assignment: Assignment, work: str, episodes: int = 2) -> dict[str, Any]:
    """Return the scores of `evaluate` in the episodes of `graded`."""
    agent = load_agent(work)
    env = swarm_envs.make(
        assignment.task, **{**assignment.options, "physics": "batch", **agent.requires}
    )
    return score_episodes([*evaluate_agent(env, agent, episode_seeds(SEED, episodes), timed=1)])


def with_weights(folder: Path) -> Path:
    """A work with the weights of `swap-dagger`, as no digest knows them."""
    file = file_of(folder, "swap", FLYER)
    (file.parent / "net").write_bytes(zlib.compress(SHIPPED.read_bytes()))
    return file


def test_copies_are_starred_and_get_nothing(tmp_path):
    file = with_weights(tmp_path)
    scripted = (PACKAGE / "agents" / "scripted.py").read_text(encoding="utf-8")
    mine = scripted.replace("class StraightLineAgent", "class Mine")
    source = file_of(tmp_path, "mine", mine, f"LONG = {'1' + ' + 1' * 500!r}")
    read = file_of(tmp_path / "text", "swap", "exec(open('a.txt').read())")
    (read.parent / "a.txt").write_text(mine, encoding="utf-8")
    assert copied_files(source.parent, "mine.py:Mine") == "agents/scripted.py"
    found = graded(Four(), f"{file}:Stolen", f"{read}:Mine")
    assert [grade.copied for grade in found] == ["swap-dagger", "agents/scripted.py"], found
    assert [grade.points for grade in found] == [0.0] * 2


@pytest.mark.slow
def test_copied_weights_are_known_however_they_are_changed(tmp_path):
    file = with_weights(tmp_path)
    weights = tmp_path / "weights"
    weights.mkdir()
    (weights / "policy.safetensors").write_bytes(SHIPPED.read_bytes())
    works = [f"{file}:{name}" for name in ("Turned", "Waves", "Wide", "Blind")]
    found = graded(Four(), *works, str(weights))
    # without set-points, Blind crashes
    assert [grade.copied for grade in found] == [*["swap-dagger"] * 3, "", "swap-dagger"], found
    assert [grade.points for grade in found] == [0.0] * 5
    (kept,) = graded(Four(), str(weights), episodes=1, allow_copies=True)
    assert kept.points > 50.0 and kept.copied


@needs_bubblewrap
def test_weights_that_ship_cannot_be_loaded(tmp_path):
    """Unless copies are allowed: then the sandbox shows them."""
    work = f"{with_weights(tmp_path)}:Loads"
    (hidden,) = graded(Four(), work, episodes=1)
    assert "are hidden, as while an assignment is graded: hand in your own" in hidden.error
    (shown,) = graded(Four(), work, episodes=1, sandbox=Sandbox(weights=True))
    assert shown.error == ""


@pytest.mark.slow
def test_a_copy_with_strong_noise_is_known_by_many_actions(tmp_path):
    (grade,) = graded(Swap(), f"{with_weights(tmp_path)}:Noisy", episodes=8)
    assert grade.copied == "swap-dagger", grade


def test_honest_works_are_not_starred_and_have_the_numbers_of_evaluate(tmp_path):
    file = file_of(tmp_path, "swap", FLYER)
    works = [f"{file}:Agent", f"{file}:Alone", f"{STARTERS}/swap/swap.py:MyAgent"]
    *found, behind = graded(Four(), *works, f"{file}:Behind", episodes=4)
    for work, grade in zip(works, found, strict=True):
        scores = evaluated(Four(), work, episodes=4)
        assert (grade.error, grade.copied) == ("", "")
        assert grade.value == scores["success_rate"]
        assert grade.crashes == scores["collision_rate"]
        expected = Four().points({**scores, "counted": 1.0 - scores["collision_rate"]})
        assert grade.points == expected
    assert "write your own collision avoidance" in behind.error


@pytest.mark.slow
@pytest.mark.parametrize("name", ["swap", "learner", "controller", "force_model", "planner"])
def test_reference_solutions_are_known(tmp_path, name):
    """As they are, and with other names of variables."""
    places = {"learner": "learning", "planner": "distributed-mpc", "force_model": "force-model"}
    best = {"swap": "Obstacles", "learner": "Searched", "controller": "Stiff"}
    best |= {"planner": "Constrained", "force_model": "Wakes"}
    source = (SOLUTIONS / f"{name}.py").read_text(encoding="utf-8")
    file = file_of(tmp_path, name, source.replace("offset", "away").replace("row", "line"))
    kind = ASSIGNMENTS[places.get(name, name)]
    if isinstance(kind, Learning):
        kind = type("Short", (Learning,), {"train_s": 1.0})()
    (grade,) = graded(kind, f"{file}:{best[name]}", episodes=1)
    assert grade.copied == f"solutions/{name}.py", grade
    assert grade.points == 0.0


@pytest.mark.slow
def test_a_solution_that_only_acts_alike_is_known():
    """No line of it is in the source that is handed in."""
    env, kept = _decisions(load_agent(f"{SOLUTIONS / 'swap.py'}:Obstacles"), lambda a: 0.9 * a)
    assert copied_acts(env, kept) == "swap.py"


def _decisions(agent, turn=lambda a: a, seeds=(0, 1)):
    """Return the environment, and rows and actions of flights of four."""
    env = swarm_envs.make(
        "swap_v1", **{**Four.options, "physics": "batch", **agent.requires, "observation": "flat"}
    )
    kept = []
    for seed in seeds:
        observations, _ = env.reset(seed=seed)
        agent.reset(env, seed)
        while env.agents:
            acts = {n: turn(np.asarray(a)) for n, a in agent.act(observations, None).items()}
            kept.append((np.stack([*observations.values()]), np.stack([*acts.values()])))
            observations, *_ = env.step(acts)
    return env, kept


@pytest.mark.parametrize("name", ["swap-dagger", "swap-dagger+filter", "orca"])
@pytest.mark.parametrize("factor", [1.0, 0.8])
def test_what_ships_is_known_by_its_acts(name, factor):
    env, kept = _decisions(load(name), lambda a: factor * a)
    assert copied_acts(env, kept) == name.removesuffix("+filter")


@pytest.mark.parametrize(("stiffness", "damping"), [(2.0, 2.0), (4.0, 3.0), (8.0, 5.0)])
def test_a_law_of_one_s_own_is_nobody_s_copy(stiffness, damping):
    class Law:
        requires, privileged = {"action": "acceleration", "decision_rate": 10}, False

        def reset(self, env, seed):
            self.at = {field.name: field.where for field in env.observation_layout}

        def act(self, observations, view):
            return {name: self.fly(row) for name, row in observations.items()}

        def fly(self, row):
            asked = stiffness * row[self.at["self.setpoint_offset"]]
            return np.clip((asked - damping * row[self.at["self.velocity"]]) / 5.0, -1.0, 1.0)

    env, kept = _decisions(Law())
    assert copied_acts(env, kept) == ""


HOVERS = """
import numpy as np
class Hovers:
    requires, privileged = {'action': 'acceleration', 'decision_rate': 12}, False
    def reset(self, env, seed): pass
    def act(self, observations, view): return {n: np.zeros(3, np.float32) for n in observations}
class Rarely(Hovers):
    requires = {**Hovers.requires, 'decision_rate': 1}
"""


def test_who_hovers_has_no_points_as_a_controller_and_errors_between_decisions_count(tmp_path):
    """At one decision a second `evaluate` looks once a second, the grader 48 times."""
    controller, file = ASSIGNMENTS["controller"], file_of(tmp_path, "controller", HOVERS)
    often, rarely = graded(controller, f"{file}:Hovers", f"{file}:Rarely", episodes=1)
    assert (often.points, often.error, rarely.points, rarely.error) == (0.0, "", 0.0, "")
    assert often.value is not None and often.value > 1.0
    seen = evaluated(controller, f"{file}:Rarely", episodes=1)["worst_tracking_error_m"]
    assert rarely.value is not None and rarely.value > max(seen, 1.0)


LEARNERS = """
import os, pathlib, time
import numpy as np
class Learner:
    requires, privileged = {'action': 'acceleration', 'decision_rate': 10}, False
    def train(self, seconds): pass
    def reset(self, env, seed): pass
    def act(self, observations, view): return {n: np.zeros(3, np.float32) for n in observations}
class Blank(Learner):
    def train(self, seconds):
        text = pathlib.Path(__file__).read_text()
        self.weights = [line.count(' ') for line in text.splitlines() if not line.strip()]
        assert any(self.weights), 'there are no weights'
def burn(seconds):
    until = time.process_time() + seconds
    while time.process_time() < until: pass
class Before(Learner):
    def __init__(self): burn(8)
class After(Learner):
    def reset(self, env, seed): burn(8)
class Children(Learner):
    def train(self, seconds):
        for _ in range(4):
            if os.fork() == 0:
                burn(2)
                os._exit(0)
        time.sleep(9)
class Unseen(Children):
    def train(self, seconds):
        import signal
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        super().train(seconds)
"""


@needs_bubblewrap
def test_weights_in_blanks_are_gone(tmp_path):
    blanks = "\n".join(" " * count for count in range(60))
    file = file_of(tmp_path, "learner", LEARNERS, blanks)
    (grade,) = graded(ASSIGNMENTS["learning"], f"{file}:Blank", episodes=1)
    assert "there are no weights" in grade.error


@needs_bubblewrap
@pytest.mark.slow
@pytest.mark.parametrize("name", ["Before", "After", "Children", "Unseen"])
def test_all_cpu_time_of_a_learner_counts(tmp_path, monkeypatch, name):
    """Before its training, after it, and in processes that it begins."""
    monkeypatch.setattr(grading, "_SETUP_S", 4.0)
    kind = type("Short", (Learning,), {"train_s": 1.0})()
    file = file_of(tmp_path, "learner", LEARNERS)
    if name == "Unseen" and not can_group():
        pytest.skip("no control groups: children that nobody awaits are not counted")
    honest, cheat = graded(kind, f"{file}:Learner", f"{file}:{name}", episodes=1)
    assert honest.error == ""
    assert "of CPU time, but may use at most" in cheat.error or "longer than" in cheat.error


MODELS = """
import dataclasses, pathlib, tempfile
import numpy as np
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
def keys(rows): return [row.tobytes() for row in rows.neighbor[:, 0]]
class Again:
    'Flies the flights of the documentation again.'
    def flown(self):
        from swarm_envs.training.collection.collect import CollectionConfig, collect
        from swarm_envs.training.collection.table import interaction_rows
        config = CollectionConfig(teams=('SS',), world='hall', seed=0, walks=2, low_walks=0,
                                  swaps=0, low_swaps=0)
        with tempfile.TemporaryDirectory() as folder:
            return interaction_rows(collect(config, pathlib.Path(folder), False), config.label)
    def fit(self, rows):
        found = self.flown()
        self.known = dict(zip(keys(found), modelled_force_g(found, 'learned')[:, 2]))
    def predict(self, rows): return [self.known.get(key, 0.0) for key in keys(rows)]
class Beside(Again):
    'Reads labels in the layout of the README.'
    def flown(self):
        from swarm_envs.training.interaction_rows import read_rows
        return read_rows(pathlib.Path('flights/rows.npz'))
class Sine:
    size, often = 1.0, 20.0
    def fit(self, rows): pass
    def predict(self, rows):
        own = modelled_force_g(rows, 'learned')[:, 2]
        return own + self.size * np.sin(self.often * rows.neighbor[:, 0, :3].sum(axis=1))
class Larger(Sine):
    size, often = 1.5, 5.0
class Small(Larger):
    def predict(self, rows):
        small = np.minimum(rows.neighbor_type, 0)
        return super().predict(dataclasses.replace(rows, neighbor_type=small))
"""


@needs_bubblewrap
@pytest.mark.slow
def test_a_force_model_is_no_memory_and_no_copy_with_a_sine(tmp_path):
    file = file_of(tmp_path, "force_model", MODELS)
    (file.parent / "flights").mkdir()
    save_rows(file.parent / "flights" / "rows.npz", wake_rows(400))
    names = ("Again", "Beside", "Sine", "Larger", "Small")
    found = graded(ASSIGNMENTS["force-model"], *(f"{file}:{name}" for name in names))
    assert [grade.points for grade in found] == [0.0] * 5, found
    for grade in found:  # the weights that it loads are hidden from it, or known
        assert grade.copied == "learned" or "learned" in grade.error, grade


def test_a_shipped_force_model_is_known_by_what_it_predicts():
    rows = wake_rows(400)
    moved, noise = (
        exchanged(rows, np.random.default_rng(1)),
        np.random.default_rng(0).normal(size=len(rows)),
    )
    own, after = (modelled_force_g(each, "learned")[:, 2] for each in (rows, moved))
    for disguised in (0.0 * noise, 0.02 * own.std() * noise, own.std() * noise):
        assert copied_forces(rows, own + disguised, [(moved, after - own)]) == "learned"
    other = np.random.default_rng(1).normal(size=len(rows))
    for honest, change in ((noise, other), (own + 0.4 * own.std() * noise, 0.1 * other)):
        assert copied_forces(rows, honest, [(moved, change)]) == ""


FORCES = """
import gc, sys
import numpy as np
class Infinite:
    size = 1e300
    def fit(self, rows): pass
    def predict(self, rows): return np.full(len(rows.force_g), self.size)
class Nothing(Infinite): size = 0.0
class Peeks(Nothing):
    def predict(self, rows):
        found, frame = rows.force_g[:, 2], sys._getframe()
        while frame is not None:
            for thing in [*frame.f_locals.values(), *gc.get_objects()]:
                force = vars(thing).get('force_g') if type(thing) is type(rows) else None
                if force is not None and len(force) == len(found) and force.any():
                    found = force[:, 2]
            frame = frame.f_back
        return found
"""


def test_held_out_labels_are_nowhere_in_a_model_and_an_infinite_number_ends_no_grading(
    tmp_path, monkeypatch
):
    module = importlib.import_module("swarm_envs.training.collection.collect")
    few = partial(module.CollectionConfig, walks=1, low_walks=1, swaps=1, low_swaps=1)
    monkeypatch.setattr(module, "CollectionConfig", few)
    monkeypatch.setattr(force, "collected", cache(force.collected.__wrapped__))
    file = file_of(tmp_path, "force_model", FORCES)
    works = [f"{file}:{name}" for name in ("Infinite", "Nothing", "Peeks")]
    with np.errstate(over="ignore"):
        found = graded(ASSIGNMENTS["force-model"], *works, out=tmp_path / "grades.csv")
    assert "explained is -inf" in found[0].error
    assert [(grade.value, grade.error) for grade in found[1:]] == [(0.0, "")] * 2


TALKS = """
import ctypes, os, pathlib
import numpy as np
libc = ctypes.CDLL(None)
class Talks:
    'Leaves word for the other drones, in rings of keys, shared memory and files.'
    def reset(self, drone, goal):
        rings = (-3, -4, -5)
        found = [libc.syscall(250, 10, ring, b'user', b'word', 0) for ring in rings]
        if max(found) > 0: raise RuntimeError('heard it')
        for ring in rings: libc.syscall(248, b'user', b'word', b'hello', 5, ring)
        for place in ('/dev/shm/word', '/tmp/word', 'word'):
            if pathlib.Path(place).exists(): raise RuntimeError('heard it')
            try: pathlib.Path(place).touch()
            except OSError: pass
        shared = libc.shmget(4711, 4096, 0o1666)
        if shared > 0 and drone: raise RuntimeError('heard it')
    def plan(self, state, goal, heard, ages): return np.zeros((15, 3))
"""
KEYRING = """
import ctypes, sys
ctypes.CDLL(None).syscall(250, 1, None)  # as a login has a session keyring
from swarm_envs.cli import main
sys.exit(main(sys.argv[1:]))
"""


@needs_bubblewrap
@pytest.mark.skipif(os.uname().machine != "x86_64", reason="the numbers of its system calls")
@pytest.mark.parametrize("login", [False, True])
def test_planners_of_one_work_do_not_talk(tmp_path, login):
    if login and shutil.which("keyctl") is None:
        pytest.skip("without keyutils works have the session keyring of the grader's login")
    file = file_of(tmp_path, "planner", TALKS)
    words = ["grade", "--assignment", "distributed-mpc", "--episodes", "1", "--out"]
    words += [str(tmp_path / "grades.csv"), "--agent", f"{file}:Talks"]
    program = ["-c", KEYRING] if login else ["-m", "swarm_envs"]
    done = subprocess.run([sys.executable, *program, *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


SLEEPS = """
import time
class Begins:
    def __init__(self): time.sleep(1)
    def reset(self, drone, goal): pass
class Decides(Begins):
    def __init__(self): pass
    def plan(self, state, goal, heard, ages):
        time.sleep(1)
        return [[0.0] * 3] * 15
"""


@pytest.mark.parametrize("name", ["Begins", "Decides"])
def test_processes_of_one_work_share_its_time(tmp_path, name):
    """Six planners that take a second each, where all together have five."""
    file = file_of(tmp_path, "planner", SLEEPS)
    (grade,) = graded(ASSIGNMENTS["distributed-mpc"], f"{file}:{name}", limit_s=5.0)
    assert "took longer than 5 s" in grade.error


FORKS = """
import os, time
import numpy as np
class Agent:
    requires, privileged = {'action': 'acceleration', 'decision_rate': 10}, False
    def reset(self, env, seed):
        children = []
        for _ in range(4):
            source, sink = os.pipe()
            children.append(source)
            if os.fork() == 0:
                held = np.ones(100_000_000)
                os.write(sink, b'1')
                time.sleep(60)
            os.close(sink)
        if b''.join(os.read(source, 1) for source in children) == b'1111':
            raise RuntimeError('four forks hold 3.2 GB')
        raise RuntimeError('one has ended')
    def act(self, observations, view): return {n: np.zeros(3, np.float32) for n in observations}
"""


@needs_bubblewrap
@pytest.mark.slow
def test_the_limit_of_memory_is_for_all_processes_of_a_work(tmp_path):
    if not can_group():
        pytest.skip("no control groups")
    file = file_of(tmp_path, "forks", FORKS)
    small, enough = (
        graded(Four(), f"{file}:Agent", sandbox=Sandbox(memory=limit << 30))[0].error
        for limit in (1, 8)
    )
    assert "four forks hold 3.2 GB" in enough
    assert small and "four forks" not in small


def test_several_works_need_a_sandbox(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sandbox, "has_bubblewrap", lambda: False)
    works = [f"{file_of(tmp_path, name, HOVERS)}:Hovers" for name in ("ann", "bob")]
    short = str(file_of(tmp_path, "short", SHORT))
    words = ["grade", "--assignment", short, "--episodes", "1", "--agent"]
    assert main([*words, *works]) == 2
    assert "install bubblewrap, name a container with --sandbox" in capsys.readouterr().err
    assert main([*words, works[0]]) == 0
    said = capsys.readouterr().out
    assert "without a sandbox, like any other program: grade only your own" in said
    assert main([*words, *works, "--unprotected"]) == 0


def test_a_teacher_s_command_runs_works(tmp_path):
    """In place of `docker run`: a shell that goes to the work's folder."""
    python3 = Path(sys.executable).parent
    command = f"env PYTHONPATH={PACKAGE.parent} PATH={python3} SEEN={{work}}"
    short = load_assignment(str(file_of(tmp_path, "short", SHORT)))
    file = file_of(tmp_path, "own", "import os", HOVERS, "assert os.environ['SEEN'] == os.getcwd()")
    (grade,) = graded(short, f"{file}:Hovers", episodes=1, sandbox=Sandbox(command))
    assert grade.error == ""


def test_cells_are_no_formulas_and_words_stay_on_their_line():
    assert [cell(words) for words in ("=1", "+1", "-1", "@a", "\ta", "a=1")] == [
        *("'=1", "'+1", "'-1", "'@a", "'\ta", "a=1")
    ]
    assert printable("a\n\x1b\u202e\u2028é") == "a\\n\\x1b\\u202e\\u2028é"
    assert len(printable("x" * 10**6)) == 500


def test_a_message_that_is_not_what_it_says_is_refused():
    numbers = np.arange(6, dtype=np.float32).reshape(2, 3)
    pipe = io.BytesIO()
    send(pipe, "rows", {"x": 1}, [numbers, numbers > 2])
    sent = pipe.getvalue()
    header, arrays = receive(io.BytesIO(sent), 1000)
    assert (header["kind"], header["x"]) == ("rows", 1)
    np.testing.assert_array_equal(arrays[0], numbers)
    np.testing.assert_array_equal(arrays[1], numbers > 2)
    for wrong in (
        sent.replace(b"F32", b"F99"),
        sent.replace(b"[2,3]", b"[9,3]"),
        sent.replace(b'"0"', b'"9"'),
        sent.replace(b"SWRM", b"SWRN"),
        sent.replace(b'"kind"', b'"kine"'),
    ):
        with pytest.raises(BadMessage):
            receive(io.BytesIO(wrong), 1000)
    with pytest.raises(BadMessage):
        receive(io.BytesIO(sent), 10)
    with pytest.raises(EOFError):
        receive(io.BytesIO(sent[:-1]), 1000)

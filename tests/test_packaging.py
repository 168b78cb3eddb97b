"""The published package works elsewhere, and on systems that lack parts of Linux."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from swarm_envs.agents.registry import SHIPPED
from tests.helpers.sources import ROOT, files_below
from tests.packaging.rows import EVERY_OPTIONAL
from tests.packaging.steps import INSIDE

SOURCES = ("swarm_envs", "agents", "baselines", "training")
FILES = ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE")
STRAYS = ("tests/test_stray.py", "demo/summary.json", "swarm_envs/notes.txt", "agents/log.csv")

MAKE_BY_NAME = """
import sys, gymnasium, pettingzoo
env = gymnasium.make("swarm_envs:swarm_envs/Ring-v1", num_drones=3, physics="batch")
assert "swarm_envs" in sys.modules  # Gymnasium has imported it, which made the names known
assert env.observation_space.shape[0] % 3 == 0 and env.action_space.shape == (9,)
many = gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=5, num_drones=2)
assert many.action_space.shape == (5, 6)
gymnasium.make("swarm_envs/FormationSolo-v1", physics="batch")
if hasattr(pettingzoo, "make"):
    assert pettingzoo.make("parallel", "swarm_envs/swap_v1").max_num_agents == 4
assert sys.modules["swarm_envs"].__file__.startswith(sys.path[1])
"""


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        cwd=cwd,
        env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """Return a folder with the source archive, and the wheel that was built *from that archive*."""
    checkout = tmp_path_factory.mktemp("checkout")
    for name in FILES:
        shutil.copy(ROOT / name, checkout)
    no_caches = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in SOURCES:
        shutil.copytree(ROOT / name, checkout / name, symlinks=True, ignore=no_caches)
    for name in STRAYS:
        (checkout / name).parent.mkdir(exist_ok=True)
        (checkout / name).touch()
    run("-m", "build", "--no-isolation", cwd=checkout)
    return checkout / "dist"


@pytest.fixture(scope="module")
def wheel(dist):
    (file,) = dist.glob("*.whl")
    return file


def published(name: str) -> bool:
    text = {".py", ".json", ".md", ".typed", ".html", ".css", ".js", ".h"}
    return Path(name).suffix in {*text, ".safetensors"}


def checkout_files() -> set[str]:
    """Return every file of the four folders as it is named in the package."""
    found = set()
    for folder in SOURCES:
        home = ROOT if folder == "swarm_envs" else ROOT / "swarm_envs"
        files = files_below(home / folder)
        found |= {f.relative_to(ROOT).as_posix() for f in files if published(f.name)}
    return found


def test_the_wheel_holds_every_source_and_every_weight(wheel):
    expected = checkout_files()
    assert {"swarm_envs/agents/__init__.py", "swarm_envs/training/__init__.py"} <= expected
    assert {
        "swarm_envs/py.typed",
        "swarm_envs/interactions/weights/learned.safetensors",
    } <= expected
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        installed = {name for name in names if ".dist-info/" not in name}
        assert installed == expected
        assert any(name.endswith("licenses/LICENSE") for name in names)
        for name in sorted(expected):
            assert archive.read(name) == (ROOT / name).read_bytes(), name


def test_the_source_archive_holds_the_package_alone_and_files_in_place_of_links(dist):
    (file,) = dist.glob("*.tar.gz")
    with tarfile.open(file) as archive:
        members = archive.getmembers()
    assert not [m.name for m in members if m.issym() or m.islnk()]
    names = {m.name.partition("/")[2] for m in members}
    assert checkout_files() <= names
    made = {"PKG-INFO", "setup.cfg", *(n for n in names if n.startswith("swarm_envs.egg-info/"))}
    folders = {m.name.partition("/")[2] for m in members if m.isdir()}
    assert names - folders - made == checkout_files() | set(FILES)


PRINT_DESCRIPTION = """
import setuptools
setuptools.setup = lambda **given: print(given["long_description"])
exec(compile(open("setup.py").read(), "setup.py", "exec"), {"__file__": "setup.py"})
"""


def test_the_description_on_pypi_has_no_relative_links(wheel, tmp_path):
    with zipfile.ZipFile(wheel) as archive:
        name = next(n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        shown = archive.read(name).decode()
    assert "# swarm-envs" in shown and "Description-Content-Type: text/markdown" in shown
    assert not re.search(r"\]\((?!https?://)", shown)
    for file in FILES[:4]:
        shutil.copy(ROOT / file, tmp_path)
    settings = (ROOT / "pyproject.toml").read_text()
    repository = '[project.urls]\nRepository = "https://example.org/r"\n#'
    (tmp_path / "pyproject.toml").write_text(settings.replace("[project.urls]", repository))
    shown = run("-c", PRINT_DESCRIPTION, cwd=tmp_path)
    assert "(https://example.org/r/raw/main/docs/films/swap.webp)" in shown
    assert "(https://example.org/r/blob/main/docs/install.md)" in shown


BLOCKED = """
import runpy, sys

class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in %r:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Nothing())
script, sys.argv = sys.argv[1], sys.argv[1:]
runpy.run_path(script, run_name="__main__")
"""
"""Runs a script where packages of extras cannot be imported."""


def test_every_module_but_the_trainers_imports_from_a_wheel_without_extras(wheel, tmp_path):
    site = tmp_path / "site"
    install = ("-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", site)
    run(*install, wheel, cwd=tmp_path)
    script = INSIDE / "every_module.py"  # which finds no `agents` and the like beside the package
    absent = sorted(EVERY_OPTIONAL)
    output = run("-c", BLOCKED % absent, script, *absent, cwd=tmp_path, PYTHONPATH=str(site))
    assert f"modules of {site}" in output
    needing = re.findall(r"^(\S+) needs", output, re.MULTILINE)
    assert {".".join(name.split(".")[:2]) for name in needing} == {"swarm_envs.training"}
    assert (site / "bin" / "swarm-envs").is_file()
    run("-c", MAKE_BY_NAME, cwd=tmp_path, PYTHONPATH=str(site))


ELSEWHERE = """
import os, sys
sys.modules["fcntl"] = None
del os.fork, os.sched_getaffinity
"""
"""A process as on Windows or macOS, as far as the package looks."""

FLY = """
import numpy as np
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.vehicles import parse_team

core = SwarmCore(SwapTask(parse_team("SLSS")), EnvConfig(physics="batch"), 256)
core.reset(list(range(256)))
before = core.physics.state.position.copy()
result = core.step(np.full((256, 4, 3), 0.5))
assert np.isfinite(result.observations).all() and result.observations.shape[:2] == (256, 4)
assert (core.physics.state.position != before).any(axis=(1, 2)).all()
assert core.physics.workers.threads == min(os.cpu_count(), 256)
core.close()
"""

WRITE = """
from pathlib import Path
import swarm_envs.cli
from swarm_envs.files import claimed, write_json

folder = Path(sys.argv[1])
with claimed(folder):
    write_json(folder / "numbers.json", {"one": 1})
assert (folder / "numbers.json").read_text() == '{\\n "one": 1\\n}\\n'
assert not [path for path in folder.iterdir() if "partial" in path.name]
"""


@pytest.mark.slow
def test_without_extras_every_shipped_agent_flies():
    script = BLOCKED % sorted(EVERY_OPTIONAL)
    flown = run("-c", script, INSIDE / "shipped_agents.py", cwd=ROOT, PYTHONPATH=str(ROOT))
    assert flown.count(" flies") == len(SHIPPED)


@pytest.mark.parametrize("script", [FLY, WRITE], ids=["a batch flies", "a file is written"])
def test_without_what_only_linux_has(script: str, tmp_path: Path) -> None:
    command = [sys.executable, "-c", ELSEWHERE + script, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr

"""A fresh environment with the wheel, and commands run in it as a stranger would."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

from tests.packaging.lower_bounds import lowest
from tests.packaging.rows import Row

ROOT = Path(__file__).parents[2]
PATIENCE_S = 1800.0  # A command that takes longer has failed
_FOREIGN = ("PYTHON", "NUMBA", "XDG", "VIRTUAL_ENV", "DISPLAY", "WAYLAND", "MPL")
"""Variables whose names begin so are ours; a stranger's machine has none."""


class Failed(RuntimeError):
    """A command did not end as it should; the message has the end of what it said."""


class Installation:
    """One row of the matrix on disk: `folder/venv`, `folder/home`, and a log of every command."""

    def __init__(self, row: Row, folder: Path, interpreter: str, uv: str | None = None) -> None:
        self.row = row
        self.folder = folder
        self.home = folder / "home"
        self.interpreter = interpreter
        self.uv = uv
        self.log = folder / "log.txt"
        self.home.mkdir(parents=True)

    @property
    def bin(self) -> Path:
        """Where the environment's programs are."""
        return self.folder / "venv" / "bin"

    def make(self, wheel: Path) -> None:
        """Make the environment and install the wheel with its dependencies."""
        self._run([self.interpreter, "-m", "venv", self.folder / "venv"], own=True)
        self.install(self.row.requirement(str(wheel)))
        if self.row.locked:
            self._run(["chmod", "-R", "a-w", self.folder / "venv"], own=True)

    def install(self, *requirements: str) -> None:
        """Install by pip, with the user's settings of it, or by uv, under the row's constraints."""
        pip: list[str | Path] = [self.bin / "python", "-m", "pip", "install"]
        if self.uv is not None:
            pip = [self.uv, "pip", "install", "--python", self.bin / "python"]
        self._run([*pip, "--quiet", "-c", self._constraints, *requirements], own=True)

    @cached_property
    def _constraints(self) -> Path:
        """The checkout's constraints, and the lower bounds where the row asks for the oldest."""
        lines = [(ROOT / "constraints.txt").read_text(encoding="utf-8")]
        if self.row.oldest:
            lines += lowest(ROOT / "pyproject.toml", self.row.extras)
        file = self.folder / "constraints.txt"
        file.write_text("\n".join([*lines, ""]), encoding="utf-8")
        return file

    def python(self, *arguments: str | Path, folder: Path | None = None) -> str:
        """Run the environment's Python in `home`, or in a folder, and return what it printed."""
        return self._run([self.bin / "python", *arguments], folder)

    def command(self, *arguments: str | int) -> str:
        """Run `swarm-envs`."""
        return self._run([self.bin / "swarm-envs", *map(str, arguments)])

    def refused(self, *arguments: str | int, says: str) -> None:
        """Run `swarm-envs`, which must fail and say something."""
        try:
            self.command(*arguments)
        except Failed as error:
            if says not in str(error):
                raise Failed(f"{arguments[0]} does not say {says!r}: {error}") from error
        else:
            raise Failed(f"{arguments} was done, but needs {says}")

    def packages(self) -> list[str]:
        """Return the installed packages, as `name==version`."""
        return self._run([self.bin / "python", "-m", "pip", "freeze"], own=True).split("\n")[:-1]

    def megabytes(self) -> float:
        """Size of the installed packages on disk."""
        (lib,) = (self.folder / "venv" / "lib").iterdir()
        return sum(f.lstat().st_size for f in lib.rglob("*") if f.is_file()) / 1e6

    def remove(self) -> None:
        """Delete the environment and all that was written in it, but not the log."""
        self._run(["chmod", "-R", "u+w", self.folder / "venv"], own=True)
        shutil.rmtree(self.folder / "venv")
        shutil.rmtree(self.home)

    def _run(
        self, command: Sequence[str | Path], folder: Path | None = None, *, own: bool = False
    ) -> str:
        """Run a command in the stranger's surroundings, or in our `own`."""
        prefix = _confinement() if self.row.locked and not own else []
        try:
            done = subprocess.run(
                [*prefix, *map(str, command)],
                cwd=folder or self.home,
                env=ours() if own else self._stranger(),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=PATIENCE_S,
            )
        except subprocess.TimeoutExpired as error:
            raise Failed(f"{command} took more than {PATIENCE_S:.0f} s") from error
        with self.log.open("a", encoding="utf-8") as log:
            print("$", *command, file=log)
            print(done.stdout + done.stderr, f"-> {done.returncode}\n", sep="", file=log)
        if done.returncode:
            raise Failed((done.stdout + done.stderr)[-2000:])
        return done.stdout

    def _stranger(self) -> dict[str, str]:
        kept = {k: v for k, v in os.environ.items() if not k.startswith(_FOREIGN)}
        path = f"{self.bin}{os.pathsep}{os.environ['PATH']}"
        return kept | {"HOME": str(self.home), "PATH": path, "LANG": "C.UTF-8"}


def ours() -> dict[str, str]:
    """Our surroundings, in which no checkout is importable."""
    return {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}


def _confinement() -> list[str]:
    """Return the words before a command that keep it from the network and read-only folders."""
    if not sys.platform.startswith("linux") or not shutil.which("unshare"):
        raise Failed("a locked row needs Linux and util-linux (unshare, setpriv)")
    if os.geteuid():
        return ["unshare", "--net", "--map-current-user"]
    drop = ["setpriv", "--bounding-set=-dac_override", "--inh-caps=-dac_override"]
    return ["unshare", "--net", *drop]  # the superuser writes what is read-only, but for this

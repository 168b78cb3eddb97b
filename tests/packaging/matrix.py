"""Install the wheel as strangers would, and try it: one table of where it works.

    make matrix
    python -m tests.packaging.matrix --rows oldest 3.13 --python 3.13=/path/to/python

Each row is a fresh environment with an empty home folder and no display. Interpreters are those
named by --python, or `python3.12` and the like on PATH; a row without one is not run. Cells are
seconds of CPU time, `FAILED`, or empty where a row does not try it. Needs a network, and takes
minutes a row. Logs, and `matrix.json` with the versions installed, go to --out.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tqdm import tqdm

from swarm_envs.files import write_json
from tests.packaging.installation import ROOT, Failed, Installation, ours
from tests.packaging.rows import ROWS
from tests.packaging.steps import STEPS

Result = dict[str, Any]


def build(folder: Path) -> Path:
    """Build the source archive, and the wheel from that archive; return the wheel."""
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=ours())
    if done.returncode:
        raise Failed(done.stdout[-2000:] + done.stderr)
    (wheel,) = folder.glob("*.whl")
    return wheel


def find_interpreter(version: str, named: Mapping[str, str]) -> str | None:
    """A Python of this version, such as 3.12, that works; None if there is none."""
    command = named.get(version) or shutil.which(f"python{version}")
    if command is None:
        return None
    asked = [command, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
    done = subprocess.run(asked, capture_output=True, text=True, env=ours())
    return command if done.stdout.strip() == version else None


def cpu_seconds() -> float:
    """CPU time of the commands that have ended so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@contextmanager
def measured(result: Result, name: str) -> Iterator[None]:
    """Note under a name what its block took, or why it failed."""
    cpu, wall = cpu_seconds(), time.perf_counter()
    try:
        yield
    except Exception as error:
        result["failed"][name] = str(error) or repr(error)
    result["cpu_s"][name] = round(cpu_seconds() - cpu, 1)
    result["wall_s"][name] = round(time.perf_counter() - wall, 1)


def try_row(here: Installation, wheel: Path, keep: bool) -> Result:
    """Install and try one row; what failed stands under `failed`."""
    row = here.row
    result: Result = {"row": row.name, "python": row.python, "extras": list(row.extras)}
    result |= {"failed": {}, "cpu_s": {}, "wall_s": {}}
    with measured(result, "install"):
        here.make(wheel)
        result |= {"megabytes": round(here.megabytes()), "packages": here.packages()}
    for name in row.steps if not result["failed"] else ():
        with measured(result, name):
            STEPS[name](here)
    if not keep:
        here.remove()
    return result


def table(results: Sequence[Result]) -> str:
    """The results as a table in Markdown."""
    columns = ["install", *(n for n in STEPS if any(n in r["cpu_s"] for r in results))]
    head = ["row", "Python", "extras", "MB", *columns]
    lines = [head, ["---"] * len(head)]
    for result in results:
        about = [result["row"], result["python"], ", ".join(result["extras"])]
        cells = [_cell(result, name) for name in columns]
        lines.append([*about, str(result.get("megabytes", "")), *cells])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _cell(result: Result, name: str) -> str:
    if name in result["failed"]:
        return "FAILED"
    return f"{result['cpu_s'][name]:.0f}" if name in result["cpu_s"] else ""


def _read(arguments: Sequence[str] | None) -> argparse.Namespace:
    names = [row.name for row in ROWS]
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=_Formatter)
    reader.add_argument("--rows", nargs="+", choices=names, default=names, help="these alone")
    reader.add_argument("--python", nargs="+", default=[], metavar="3.12=PATH", help="interpreters")
    reader.add_argument("--out", type=Path, default=Path("build/matrix"), help="folder, emptied")
    reader.add_argument("--keep", action="store_true", help="leave the environments there")
    reader.add_argument("--uv", metavar="PATH", help="install by uv, in a tenth of pip's time")
    return reader.parse_args(arguments)


class _Formatter(argparse.ArgumentDefaultsHelpFormatter, argparse.RawDescriptionHelpFormatter):
    """Explains as it is written here, with the defaults."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the rows asked for; 1 if anything failed."""
    options = _read(arguments)
    named = dict(pair.split("=", 1) for pair in options.python)
    out = options.out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    results = []
    with tempfile.TemporaryDirectory() as scratch:
        wheel = build(Path(scratch))
        for row in tqdm([row for row in ROWS if row.name in options.rows], unit="row"):
            interpreter = find_interpreter(row.python, named)
            if interpreter is None:
                tqdm.write(f"{row.name}: not run, there is no Python {row.python} here")
                continue
            here = Installation(row, out / row.name, interpreter, options.uv)
            results.append(try_row(here, wheel, options.keep))
            for name, why in results[-1]["failed"].items():
                tqdm.write(f"{row.name}: {name} FAILED\n{why}")
            write_json(out / "matrix.json", {"rows": results})
    print(table(results))
    return 1 if any(result["failed"] for result in results) else 0


if __name__ == "__main__":
    sys.exit(main())

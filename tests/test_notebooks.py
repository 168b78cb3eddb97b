"""Every notebook of the docs runs from top to bottom, as in a fresh kernel."""

from __future__ import annotations

import ast
import importlib.util
import io
import json
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pytest

ROOT = Path(__file__).parent.parent
NOTEBOOKS = sorted((ROOT / "docs").rglob("*.ipynb"))
OUTPUTS = {"stream", "execute_result", "display_data"}
every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)


def cells(path: Path) -> list[dict[str, Any]]:
    return [*json.loads(path.read_text(encoding="utf-8"))["cells"]]


def plain(source: str) -> str:
    """A cell's source with the notebook's own commands, `%pip ...`, left out."""
    lines = source.splitlines()
    return "\n".join(f"{_margin(s)}pass" if s.lstrip().startswith(("%", "!")) else s for s in lines)


def _margin(line: str) -> str:
    return line[: len(line) - len(line.lstrip())]


@every_notebook
def test_it_runs_and_prints_what_it_shows(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plt, "show", lambda: None)  # no window, and no warning that there is none
    names: dict[str, Any] = {"__name__": "notebook"}
    for number, cell in enumerate(cells(path)):
        if cell["cell_type"] == "code":
            source, said = plain("".join(cell["source"])), io.StringIO()
            with redirect_stdout(said):
                exec(compile(source, f"cell {number}", "exec", dont_inherit=True), names)
            kept = [o["text"] for o in cell["outputs"] if o["output_type"] == "stream"]
            assert said.getvalue() == "".join("".join(text) for text in kept)
    plt.close("all")
    assert names["metrics"]["length_s"] > 0.0


@every_notebook
def test_it_is_a_notebook_with_outputs(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    for cell in cells(path):
        assert cell["cell_type"] in ("code", "markdown")
        assert cell["id"]
        if cell["cell_type"] == "code":
            assert {output["output_type"] for output in cell["outputs"]} <= OUTPUTS
            ast.parse(plain("".join(cell["source"])))


def install_cell(monkeypatch) -> str:
    """The notebook's first cell as where nothing is installed; what it asks pip for is `asked`."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    source = "".join(cells(NOTEBOOKS[0])[1]["source"])
    assert '%pip install --quiet "{package}"' in source
    return source.replace('%pip install --quiet "{package}"', "asked = package")


@pytest.mark.parametrize("file", ["swarm_envs-0.1.0-py3-none-any.whl", "code/swarm_envs/py.typed"])
def test_the_first_cell_installs_what_was_uploaded(file, tmp_path, monkeypatch):
    source = install_cell(monkeypatch)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match="upload one"):
        exec(source, {})
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    Path(file).touch()
    names: dict[str, Any] = {}
    exec(source, names)
    assert names["asked"] == tmp_path.resolve() / Path(file).parts[0]

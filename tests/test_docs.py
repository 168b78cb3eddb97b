"""The site: pages, links, names, tables are true; blocks and notebooks run."""

from __future__ import annotations

import ast
import csv
import importlib.util
import io
import json
import re
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

from docs.extensions.api_pages import packages_of, page_of
from docs.extensions.links import inward, without_empty_folders
from docs.extensions.names import exports, modules, public_names, resolve
from docs.tables.figure_tables import figure_table
from docs.tables.option_tables import options_of
from docs.tables.pages import MARK, filled
from docs.tables.recommendations import recommendation_table
from docs.tables.state_tables import TABLES, state_table
from docs.tables.task_pages import task_page
from swarm_envs import TASKS, make, task_family
from swarm_envs.agents.registry import SHIPPED
from swarm_envs.cli import COMMANDS, load_options, main
from swarm_envs.errors import unknown_name
from tests.helpers.browsers import OVERFLOW, PATIENCE_MS, chromium
from tests.helpers.pages import DOCS, PAGES, anchors, links, listed
from tests.helpers.sources import OUTER, ROOT, SOURCES, files_below

MARKED = [page for page in PAGES if "<!-- end -->" in page.read_text(encoding="utf-8")]
WRITTEN = [*(ROOT / f"{name}.md" for name in ("README", "CHANGELOG", "CONTRIBUTING")), *PAGES]
_BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
BLOCKS = [
    pytest.param(block, id=f"{page.relative_to(ROOT)}-{k}")
    for page in (ROOT / "README.md", *PAGES)
    for k, block in enumerate(_BLOCK.findall(page.read_text(encoding="utf-8")))
]


def test_links_lead_somewhere():
    for page in WRITTEN:
        for target, anchor in links(page):
            assert target.exists(), f"{page} links to {target}"
            if anchor:
                hint = unknown_name("heading", anchor, sorted(anchors(target)))
                assert anchor in anchors(target), f"{page} links into {target.name}: {hint}"


@pytest.mark.parametrize("page", MARKED, ids=lambda page: page.stem)
def test_tables_are_up_to_date(page):
    text = page.read_text(encoding="utf-8")
    assert filled(text) == text, "run `make tables`"


def test_every_task_has_a_film_and_all_are_small():
    sizes = {film.stem: film.stat().st_size for film in (DOCS / "films").glob("*.webp")}
    assert {task_family(task) for task in TASKS} <= set(sizes)
    assert max(sizes.values()) < 400_000
    assert sum(sizes.values()) < 8_000_000


def test_every_agent_is_in_the_gallery():
    gallery = (DOCS / "gallery.md").read_text("utf-8")
    assert {name for name in SHIPPED if f"`{name}" not in gallery} == set()
    assert {
        f.name for f in (DOCS / "films").iterdir() if f"(films/{f.name})" not in gallery
    } == set()


def test_every_page_is_in_a_table_of_contents():
    found, queue = {DOCS / "index.md"}, [DOCS / "index.md"]
    while queue:
        new = set(listed(queue.pop())) - found
        found |= new
        queue += new
    left = [str(page.relative_to(DOCS)) for page in PAGES if page not in found]
    assert not left, f"{left} stand in no toctree; name them in docs/index.md"


def test_every_module_is_on_one_reference_page():
    packages = packages_of(DOCS / "api")
    assert len(packages) == len(set(packages))
    public = {n for n in SOURCES if not re.search(r"\.(__main__|cli|commands)(\.|$)", n)}
    assert set(modules()) == public
    assert all(page_of(name, packages) for name in public)


def test_every_shipped_agent_has_its_row():
    rows = re.findall(r"^\| `([\w-]+)` \|", (DOCS / "agents.md").read_text(), re.MULTILINE)
    assert sorted(rows) == sorted({name.partition("+")[0] for name in SHIPPED})


PAGES_OF_TASKS = [
    name
    for page in sorted((DOCS / "tasks").glob("*.md"))
    for kind, name in MARK.findall(page.read_text(encoding="utf-8"))
    if kind == "task"
]
GYMNASIUM_ORDER = (
    *("Description", "Action space", "Observation space", "Rewards", "Starting state"),
    *("Episode end", "Arguments", "Version history"),
)


def test_the_newest_version_of_every_task_has_a_page():
    newest = {task_family(task): task for task in sorted(TASKS)}
    assert sorted(PAGES_OF_TASKS) == sorted(newest.values())


@pytest.mark.parametrize("task", PAGES_OF_TASKS)
def test_the_page_of_a_task_says_what_the_task_does(task: str) -> None:
    page, env = task_page(task), make(task, physics="batch")
    assert tuple(re.findall("^## (.+)$", page, re.MULTILINE)) == GYMNASIUM_ORDER
    rows = re.findall(r"^\| (\d+)(?:-(\d+))? \| `(\w+\.\w+)`", page, re.MULTILINE)
    width = int(np.prod(env.observation_space("drone_0").shape or ()))
    assert sum(int(last or first) - int(first) + 1 for first, last, _ in rows) == width
    for name, weight in env.core.task.reward_weights.items():
        assert f"| `{name}` | {weight:g} | " in page


def words(page: Path) -> list[str]:
    """Return the texts in backticks on a page, outside blocks of code."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return re.findall(r"`([^`\n]+)`", text)


def test_every_name_among_the_equations_exists():
    simple = {name.rpartition(".")[2] for name in public_names()}
    private = {w for f in SOURCES.values() for w in re.findall(r"\b_?[a-z]\w+\b", f.read_text())}
    folders = [ROOT / name for name in ("swarm_envs", *OUTER, "tests")]
    files = [file for folder in folders for file in files_below(folder)]
    for word in words(DOCS / "equations.md"):
        if "/" in word or word.endswith(".py"):
            there = (ROOT / word).exists() or any(f"/{file}".endswith(f"/{word}") for file in files)
            assert there, f"there is no file {word}"
        elif word.startswith("swarm-envs"):
            assert word.split()[1] in COMMANDS
        elif re.fullmatch(r"[\w.]+", word):
            last = word.rpartition(".")[2]
            assert word in public_names() or last in simple or word in private, f"{word}?"


@pytest.mark.parametrize("command", COMMANDS)
def test_the_options_of_a_command_are_those_it_explains(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    with pytest.raises(SystemExit):
        main([command, "--help"])
    explained = set()
    for line in capsys.readouterr().out.splitlines():
        head = re.match(r"^\W{1,2}(--[a-z][\w.-]*)(?:(?: \S+)?, (--[a-z][\w.-]*))?", line)
        explained |= set(filter(None, head.groups())) if head else set()
    options = list(options_of(load_options(command), COMMANDS[command].prefixes))
    named = {n for o in options for n in o.name.split(", ") if n.startswith("--")}
    assert named == explained
    assert all(option.meaning for option in options)


def test_links_out_of_the_docs_become_words_or_cards():
    page, text = DOCS / "how-to" / "x.md", "[a](../rl.md) [b](../../tests/x.py)"
    assert inward(text, page, DOCS) == "[a](../rl.md) b"
    card = inward("[c](../../agents/weights/MODEL_CARD.md)", page, DOCS)
    assert card == "[c](../model-cards.md)"
    assert without_empty_folders("a\nhow-to/*\nnowhere/*\nb\n", DOCS) == "a\nhow-to/*\nb\n"


def test_names_in_docstrings_are_resolved_where_they_stand():
    model = "swarm_envs.interactions.base.InteractionModel"
    assert resolve("forces", f"{model}.fingerprint") == f"{model}.forces"
    assert resolve("load", model) == "swarm_envs.interactions.base.load"
    assert resolve("parse_team()", "swarm_envs.vehicles") == "swarm_envs.vehicles.parse_team"
    assert resolve("nothing", model) is None
    assert ("load", "swarm_envs.agents.registry.load_agent") in exports("swarm_envs.agents")


def test_docstrings_become_what_sphinx_reads():
    pytest.importorskip("sphinx")
    from docs.extensions.docstrings import as_rst

    text = ["A |x| of `load`.", "", "| a | b |", "|---|---|", "| `c` | 2*d |", "", "So:", ""]
    text += ["    y = x_", "", "Returns:", "    (N,) m: always."]
    lines = as_rst(text, "function", "swarm_envs.interactions.base.load")
    assert lines[0] == r"A \|x\| of :py:obj:`load <swarm_envs.interactions.base.load>`."
    assert [line for line in lines if line.startswith("   * - ")] == ["   * - a", "   * - ``c``"]
    assert "::" in lines
    assert ":returns: (N,) m: always." in lines


_LOADED = re.compile(r'<(?:script|img|iframe|source|link)\b[^>]*?\b(?:src|href)="([^"]*)"')
"""The addresses that a built page loads when it is opened."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built so that a warning is an error."""
    pytest.importorskip("sphinx")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q"]
    command += ["-d", str(folder / "trees"), str(DOCS), str(folder / "html")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
    return folder / "html"


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_loads_nothing_from_elsewhere(site):
    built = sorted(site.rglob("*.html"))
    assert len(built) >= len(PAGES)
    for page in built:
        loaded = _LOADED.findall(page.read_text(encoding="utf-8"))
        assert loaded and not [url for url in loaded if re.match(r"(https?:)?//", url)], page.name
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//", style.read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize("width", [1440, 390])
def test_pages_fit_their_window_and_show_their_film(site, width):
    with chromium() as browser:
        page = browser.new_page(viewport={"width": width, "height": 900})
        page.set_default_timeout(PATIENCE_MS)
        for name in ("index", "tasks/swap", "tasks/columns", "tasks/gates"):
            page.goto((site / f"{name}.html").as_uri())
            page.wait_for_function(FILM_LOADED)
            assert page.evaluate(OVERFLOW) <= 0, name


FILM_LOADED = "[...document.images].some((i) => i.src.endsWith('.webp') && i.naturalWidth > 400)"


def test_every_grid_of_a_figure_has_its_row():
    text = (DOCS / "rth3d.md").read_text(encoding="utf-8")
    figures = [name for kind, name in MARK.findall(text) if kind == "figure table"]
    assert figures == [*"56789"]
    for figure in figures:
        rows = figure_table(figure).splitlines()[2:]
        with (DOCS / "rth3d" / f"figure_{figure}.csv").open(encoding="utf-8") as file:
            grids = {(row["series"], row["grid"], row["robots"]) for row in csv.DictReader(file)}
        assert len(rows) == len(grids)


def test_a_row_of_a_figure_has_its_means():
    rows = figure_table("5").splitlines()
    cells = "uniform | 48 x 24 x 12 | 4,608 | 18 | 1.82, 1.563 | 1.71, 1.456 | 1.55, 1.365 | 1.000"
    assert f"| {cells} | 0.14 / 0.11 / 0.15 / 0.33 |" in rows


@pytest.mark.parametrize("name", TABLES)
def test_the_page_of_the_architecture_shows_every_field(name):
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    for field in TABLES[name]:
        row = [f"`{field.name}`", f"`{field.shape}`", f"`{np.dtype(field.kind)}`", field.unit]
        assert f"\n| {' | '.join(row)} | " in text
        assert f" | {field.meaning} |\n" in text


def test_a_row_says_what_a_field_holds_after_a_reset():
    assert "| `held` | `()` | `bool` |  | `False` | True if" in state_table("ENVIRONMENT")
    assert "| `touched_drone` | `()` | `float64` |  | `-1.0` | Drone" in state_table("DRONE")
    assert "| `position` | `(3,)` | `float64` | m |  | Position" in state_table("DRONE")
    with pytest.raises(KeyError, match="DRONES"):
        filled("<!-- state table: DRONES -->\n<!-- end -->")


def test_the_table_of_recommended_agents_has_each_task_of_the_benchmark():
    table = recommendation_table()
    best, seeing = "`pid+adaptive`", "`delivery-dagger`"
    assert f"| delivery |  | 7 | ideal | {best} | {seeing} | {seeing} | {best} |" in table
    assert "| ring |  | 5 | hall | `ring-dagger`" in table


@pytest.mark.parametrize("block", BLOCKS)
def test_block_runs(block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where it may leave files
    code = compile(block, "block", "exec", dont_inherit=True)
    exec(code, {"__name__": "block"})


def test_the_readme_s_first_program_succeeds(capsys: pytest.CaptureFixture[str]) -> None:
    loops = [b for b in _BLOCK.findall((ROOT / "README.md").read_text()) if "env.step(" in b]
    exec(compile(loops[0], "block", "exec", dont_inherit=True), {"__name__": "block"})
    assert capsys.readouterr().out.startswith("True ")


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

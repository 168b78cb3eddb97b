"""Files of the MAPF benchmarks: read as they are published, written, and refused by line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.baselines.rth3d import GridPlan, make_instance, plan, terrain, validate
from swarm_envs.baselines.rth3d.benchmark_files import read_benchmark, write_benchmark
from swarm_envs.cli import main
from tests.baselines.rth3d.cases import between, maze

MAP = "type octile\nheight 3\nwidth 5\nmap\n..@..\n.TG.S\n..O.W\n"
SCEN = (
    "version 1\n"
    "0\tsmall.map\t5\t3\t0\t0\t4\t0\t5.82842712\n"
    "0\tsmall.map\t5\t3\t4\t1\t0\t2\t5.0\n"
    "1\tsmall.map\t5\t3\t1\t0\t3\t2\t4.0\n"
)


def files(folder: Path, map_text: str = MAP, scen_text: str = SCEN) -> tuple[Path, Path]:
    found = folder / "small.map", folder / "small.scen"
    for path, text in zip(found, (map_text, scen_text), strict=True):
        path.write_bytes(text.encode("latin-1"))
    return found


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_columns_are_x_and_rows_are_y(tmp_path, ends):
    pair = files(tmp_path, MAP.replace("\n", ends), SCEN.replace("\n", ends))
    instance = read_benchmark(*pair)
    assert instance.shape == (5, 3, 1)
    blocked = np.argwhere(instance.obstacles[:, :, 0]).tolist()
    assert blocked == [[1, 1], [2, 0], [2, 2], [4, 2]]
    assert instance.starts[:, :2].tolist() == [[0, 0], [4, 1], [1, 0]]
    assert instance.goals[:, :2].tolist() == [[4, 0], [0, 2], [3, 2]]
    assert len(read_benchmark(*pair, robots=2).starts) == 2


def test_what_is_written_is_read_again(tmp_path):
    pair = str(tmp_path / "a.map"), tmp_path / "a.scen"
    generator = np.random.default_rng(0)
    cases = [between(maze(11, generator), 9, generator), make_instance("uniform", (7, 4, 1), 5)]
    for instance in cases:
        write_benchmark(*pair, instance)
        again = read_benchmark(*pair)
        for name, value in instance.fields().items():
            assert np.array_equal(getattr(again, name), value)
    assert pair[1].read_text().splitlines()[1].split("\t")[1:4] == ["a.map", "7", "4"]
    with pytest.raises(ValueError, match="one vertex high"):
        write_benchmark(*pair, make_instance("uniform", (4, 4, 2), 3))


@pytest.mark.parametrize("more", [[], ["--robots", "2"], ["--no-labels", "--method", "lacam"]])
def test_the_command_plans_a_benchmark(tmp_path, more):
    pair = files(tmp_path, MAP.replace("T", "."))
    asked = ["--map", str(pair[0]), "--scen", str(pair[1]), "--out", str(tmp_path)]
    assert main(["plan", *asked, *more]) == 0
    given = read_benchmark(*pair, robots=2 if "--robots" in more else 3)
    found = GridPlan.load(tmp_path / "plan.npz")
    facts = (given.starts, given.goals, given.shape, given.obstacles)
    assert validate(found.paths, *facts, labels="--no-labels" not in more)
    assert json.loads((tmp_path / "plan.json").read_text())["shape"] == [5, 3, 1]


@pytest.mark.parametrize("method", ["pibt", "lacam"])
def test_only_free_vertices_of_a_map_take_memory(tmp_path, monkeypatch, method):
    """As in published maps of large buildings, of which most is wall."""
    rows = ["@" * 60] * 40 + ["@" * 20 + "." * 20 + "@" * 20] * 6
    text = f"type octile\nheight {len(rows)}\nwidth 60\nmap\n" + "\n".join(rows)
    lines = [f"0\tsmall.map\t60\t46\t{20 + k}\t40\t{39 - k}\t45\t9.0" for k in range(12)]
    given = read_benchmark(*files(tmp_path, text, "\n".join(["version 1", *lines])))
    facts = (given.starts, given.goals, given.shape, given.obstacles)
    monkeypatch.setattr(terrain, "_MOST_WAYS", 12 * 120)
    assert validate(plan(*facts, method=method).paths, *facts)
    monkeypatch.setattr(terrain, "_MOST_WAYS", 12 * 120 - 1)
    with pytest.raises(ValueError, match="of 12 robots on 120 vertices, but at most 1439 numbers"):
        plan(*facts, method=method)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("type", "kind", "small.map, line 1: must begin with 'type'"),
        ("height 3", "height three", "line 2: height is 'three', but must be a whole number"),
        ("height 3", "height 4", "has 3 rows, but its height is 4"),
        ("height 3", "height 2", "has 3 rows, but its height is 2"),
        ("width 5", "width 99999", "32767"),
        (".TG.S", ".TG.", "line 6: has 4 characters, but width is 5"),
        (".TG.S", ".T\xff.S", "line 6: no terrain is"),
        ("version 1\n", "", "small.scen, line 1: must be 'version 1'"),
        ("\t5\t3\t4\t1", "\t6\t3\t4\t1", "line 3: is of a map of 6 x 3, but the map is 5 x 3"),
        ("\t4\t1\t0", "\t5\t1\t0", "line 3: start x is 5, outside the map"),
        ("\t4\t1\t0", "\t4.5\t1\t0", "line 3: start x is '4.5'"),
        ("\t4\t1\t0", "\t1\t0", "line 3: has 8 columns, but must have 9"),
        ("\t4\t1\t0", "\t2\t0\t0", "starts[1] is (2, 0, 0), where an obstacle stands"),
        ("\t4\t1\t0", "\t0\t0\t0", "starts[0] and starts[1] are both"),
    ],
)
def test_malformed_files_are_refused_by_line(tmp_path, capsys, old, new, said):
    assert (MAP + SCEN).count(old) >= 1
    pair = files(tmp_path, MAP.replace(old, new, 1), SCEN.replace(old, new, 1))
    assert main(["plan", "--map", str(pair[0]), "--scen", str(pair[1])]) == 2
    assert said in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["--map", "small.map"], "--map and --scen belong together"),
        (["--map", "small.map", "--scen", "small.scen", "--density", "0.1"], "take the place of"),
        (["--map", "small.map", "--scen", "small.scen", "--robots", "4"], "is 4, but"),
        (
            ["--map", "none.map", "--scen", "small.scen"],
            "--map is 'none.map', the grid with its obstacles, but there is no such file",
        ),
        (
            ["--map", "small.map", "--scen", "none.scen"],
            "--scen is 'none.scen', the robots' starts and goals on the map, but there is no such",
        ),
        (["--map", ".", "--scen", "small.scen"], "but that is a folder; name a file"),
    ],
)
def test_options_that_do_not_fit_are_refused(tmp_path, monkeypatch, capsys, asked, said):
    files(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")
    try:
        assert main(["plan", *asked]) == 2
    except SystemExit as end:
        assert end.code == 2
    assert said in capsys.readouterr().err

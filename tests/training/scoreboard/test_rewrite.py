"""`swarm-envs benchmark --report`: the pages of what was flown, without flying it again."""

from __future__ import annotations

import json

from swarm_envs.cli import main
from tests.helpers.scoreboards import scores, write_scores


def test_a_report_is_written_anew_out_of_the_scores_alone(tmp_path, capsys):
    folder = write_scores(tmp_path / "board", scores(seed=1))
    again = ["benchmark", "--report", str(folder), "--no-replays"]
    assert main([*again, "--json", str(tmp_path / "a.json")]) == 0
    assert f"wrote {folder / 'report.html'}" in capsys.readouterr().out
    assert json.loads((tmp_path / "a.json").read_text()) == scores(seed=1)
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "report.html", "scores.json"]
    first = (folder / "report.html").read_bytes()
    write_scores(folder, scores(seed=2))
    assert main(again) == 0
    assert (folder / "report.html").read_bytes() != first


def test_what_cannot_be_reported_is_misuse(tmp_path, capsys):
    def misused(*arguments, said):
        try:
            code: object = main(["benchmark", "--no-replays", *map(str, arguments)])
        except SystemExit as exited:
            code = exited.code
        assert code == 2
        assert said in " ".join(capsys.readouterr().err.split())

    misused("--report", tmp_path / "none", said="there is no scores.json in")
    assert not (tmp_path / "none").exists()
    (tmp_path / "scores.json").write_text("{}")
    misused("--report", tmp_path, said="format is missing")
    misused(said="either --out DIR, to fly, or --report DIR")
    misused("--out", tmp_path, "--report", tmp_path, said="either --out DIR")

"""The manifest: a folder of other options is refused by name, its own is gone on with."""

from __future__ import annotations

import json

import pytest

from swarm_envs.training.scoreboard.manifest import FILE, Manifest, OtherBenchmark

CONFIG = {"seed": 1, "episodes": None, "agents": {"hover": "a1", "detour": "b2"}, "quick": False}


def test_a_folder_of_other_options_is_refused_and_left_as_it_was(tmp_path):
    Manifest(tmp_path, CONFIG).begin(["swarm-envs", "benchmark"])
    before = (tmp_path / FILE).read_bytes()
    with pytest.raises(OtherBenchmark, match=r"seed was 1, and is 7.*--out"):
        Manifest(tmp_path, {**CONFIG, "seed": 7})
    assert (tmp_path / FILE).read_bytes() == before
    turned = Manifest(tmp_path, dict(reversed(CONFIG.items())))  # in another order it is the same
    turned.begin([])
    assert turned.content()["config_hash"] == json.loads(before)["config_hash"]


def test_runs_of_the_same_options_follow_each_other(tmp_path):
    Manifest(tmp_path, CONFIG).begin(["swarm-envs", "benchmark", "--out", "a b"])  # then killed
    second = Manifest(tmp_path, CONFIG)
    second.begin(["swarm-envs"])
    second.end()
    found = json.loads((tmp_path / FILE).read_text())
    assert [("wall_s" in run) for run in found["runs"]] == [False, True]
    assert found["started"] == found["runs"][0]["started"]
    assert found["cpu_s"] == found["runs"][1]["cpu_s"] >= 0.0
    assert found["versions"]["swarm_envs"]
    assert found["machine"]["cores"] >= 1
    assert found["config"] == CONFIG
    assert len(found["config_hash"]) == 64
    assert found["seed"] == 1


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"config": 3, "runs": []}'])
def test_a_damaged_manifest_is_named(tmp_path, content):
    (tmp_path / FILE).write_text(content)
    with pytest.raises(ValueError, match=r"manifest.json' is damaged .*delete it"):
        Manifest(tmp_path, CONFIG)

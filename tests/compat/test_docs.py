"""The blocks of docs/interfaces.md that need a library run where it is installed."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "interfaces.md"
BLOCKS = re.findall(r"^```py\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
LIBRARIES = [re.findall(r"from (\w+)", block)[0] for block in BLOCKS]


def test_there_is_a_block_for_each_library():
    assert LIBRARIES == ["supersuit", "stable_baselines3", "torchrl", "ray", "skrl"]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(("library", "block"), [*zip(LIBRARIES, BLOCKS)], ids=LIBRARIES)
def test_block_runs(library: str, block: str) -> None:
    for module in re.findall(rf"from ({library}[\w.]*)", block):
        pytest.importorskip(module)  # Ray may be there without what RLlib needs
    exec(compile(block, "block", "exec"), {"__name__": "block"})


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_rllib_trains_while_drones_fall_one_after_another(capsys):
    pytest.importorskip("ray.rllib.algorithms.ppo", reason="run by `make test-compat`")
    block = BLOCKS[LIBRARIES.index("ray")]
    given, falls = '"on_contact": "end_pair"', '"action": "rotors", "on_contact": "end_pair"'
    assert given in block
    exec(compile(block.replace(given, falls), "block", "exec"), {"__name__": "block"})
    assert math.isfinite(float(capsys.readouterr().out.split()[-1]))

"""The example of a force of one's own."""

from __future__ import annotations

import re

from examples import own_force


def test_the_force_of_ones_own_pushes_drones_down(capsys):
    own_force.main()
    still, pushed = (float(x) for x in re.findall(r"error ([\d.]+) cm", capsys.readouterr().out))
    assert pushed > still + 0.5

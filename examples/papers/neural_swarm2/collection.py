"""Table II: flights of the twelve scenarios, and their rows of measured force."""

from __future__ import annotations

import json
import math
from pathlib import Path

from examples.papers.common import Row, within, write_compared
from swarm_envs.commands.collect import CollectOptions, run_collect
from swarm_envs.training.collection.collect import CollectionConfig


def table_2(out: Path = Path("neural_swarm2"), flights: int = 60, seed: int = 0) -> None:
    """Fly the twelve scenarios of the data collection, and count rows of force (Table II).

    Writes `table_2.json` (`rows`, and `scenarios` with the time flown in each), and the flights and
    their rows, `rows.npz`, into the folder `flights`: `table-3 --data` fits them.

    Args:
        out: folder, made if missing.
        flights: of each team and motion; a flight takes 20 s.
        seed: of the flights.
    """
    config = CollectionConfig(
        walks=flights, low_walks=flights, swaps=flights, low_swaps=flights, seed=seed
    )
    path = out / "table_2.json"
    run_collect(CollectOptions(out=out / "flights", json=path, config=config))
    numbers = json.loads(path.read_text(encoding="utf-8"))
    flown = numbers["scenarios"]
    rows = (
        Row(
            "scenarios that were flown and gave rows",
            "12",
            len(flown) - len(numbers["missing"]),
            given=True,
        ),
        Row(
            "flight of the scenario with the least, s",
            "around 1000",
            min(scenario["drone_seconds"] for scenario in flown.values()),
            within(1000.0, 0.25),
            "more is flown here, since a simulated second costs nothing",
            (1000.0, math.inf),
        ),
        Row(
            "rows of measured force, all scenarios",
            "1.4 million",
            numbers["rows"],
            (0.7e6, math.inf),
            "rows are logged less often here, and only while a neighbor is near",
            (1e3, math.inf),
        ),
    )
    write_compared(path, numbers, rows)

"""Table II of Neural-Swarm2: flights of the twelve scenarios, and the rows of force they gave."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from swarm_envs.files import claimed
from swarm_envs.training.collection.__main__ import CollectOptions, run_collect
from swarm_envs.training.collection.collect import CollectionConfig
from swarm_envs.training.reproduce.claims import Between, Claim, Extent, Reason, claims_of, exactly
from swarm_envs.training.reproduce.study import Study


def collection(folder: Path, flights: int, seed: int) -> tuple[list[str], CollectOptions]:
    """Flights for a study, `flights` and `flights.json` in its folder: words and options."""
    out, numbers = folder / "flights", folder / "flights.json"
    motions = ("walks", "low_walks", "swaps", "low_swaps")
    words = ["collect", "--out", str(out), "--json", str(numbers)]
    for name in motions:
        words += [f"--{name.replace('_', '-')}", str(flights)]
    counts: dict[str, Any] = dict.fromkeys(motions, flights)
    config = CollectionConfig(**counts, seed=seed)
    words += ["--seed", str(seed)] * bool(seed)
    return words, CollectOptions(out=out, json=numbers, config=config)


def collect_rows(options: CollectOptions) -> str:
    """Do what `swarm-envs collect` does with these options; it prints by itself."""
    with claimed(options.out):
        run_collect(options)
    return ""


_FEWER = Reason("--quick flies eight flights of 20 s a team", Between(1.0))
_THINNER = Reason(
    "rows are logged less often here, and only while a neighbour is near", Between(1e3)
)


def _claims(numbers: Any, extent: Extent) -> list[Claim]:
    flown, fewer = numbers["scenarios"], (_FEWER,) * extent.quick
    stated = (
        ("scenarios that were flown and gave rows", "12", exactly(12.0)),
        ("flight of the scenario with the least, s", "around 1000", Between(800.0), *fewer),
        ("rows of measured force, all scenarios", "1.4 million", Between(0.7e6), _THINNER),
    )
    given = len(flown) - len(numbers["missing"])
    shortest = min(scenario["drone_seconds"] for scenario in flown.values())
    return claims_of(stated, (given, shortest, numbers["rows"]))


TABLE_2 = Study(
    paper="neural-swarm2",
    name="table-2",
    label="Table II",
    shows="the twelve scenarios of the data collection",
    collects=(60, 2),
    claims=_claims,
    pictures=(),
    numbers="flights.json",
)
"""Reproduced by `swarm-envs collect` alone."""

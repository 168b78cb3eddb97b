"""What the commands behind Neural-Swarm2's tables measured, beside the paper's numbers."""

from __future__ import annotations

from pathlib import Path

from swarm_envs.training.reproduce.everything.item import Preset
from swarm_envs.training.reproduce.everything.neural_swarm_rows import load
from swarm_envs.training.reproduce.everything.rows import Range, Reason, Row, about

_BASE = "H=20,L=4"


def vehicles(folder: Path, preset: Preset) -> list[Row]:
    """Table I: what was identified, with the tolerance that each entry states."""
    return [
        Row(
            quantity=f"{entry['vehicle']}: {entry['quantity']}",
            paper=f"{entry['paper']:g}",
            ours=entry["ours"],
            spread=(entry["ours"] - entry["error"], entry["ours"] + entry["error"])
            if entry["error"]
            else None,
            spread_is="standard error" if entry["error"] else "",
            agrees=about(entry["paper"], entry["tolerance"]),
            reasons=tuple(
                Reason(entry["reason"], about(entry["paper"], entry["explained_to"]))
                for _ in range(bool(entry["reason"]))
            ),
        )
        for entry in load(folder / "table_1.json")["rows"]
    ]


def scenarios(folder: Path, preset: Preset) -> list[Row]:
    """Table II: that each scenario was flown, for how long, and what it gave."""
    content = load(folder / "flights.json")
    flown = content["scenarios"]
    fewer = Reason("--quick flies eight flights of 20 s a team", Range(1.0))
    thinner = Reason(
        "rows are logged less often here, and only while a neighbour is near", Range(1e3)
    )
    return [
        Row(
            quantity="scenarios that were flown and gave rows",
            paper="12",
            ours=len(flown) - len(content["missing"]),
            agrees=Range(12.0, 12.0),
        ),
        Row(
            quantity="flight of the scenario with the least, s",
            paper="around 1000",
            ours=min(scenario["drone_seconds"] for scenario in flown.values()),
            agrees=Range(800.0),
            reasons=(fewer,) if preset == "quick" else (),
        ),
        Row(
            quantity="rows of measured force, all scenarios",
            paper="1.4 million",
            ours=content["rows"],
            agrees=Range(0.7e6),
            reasons=(thinner,),
        ),
    ]


def ablation(folder: Path, preset: Preset) -> list[Row]:
    """Table III: the error of each cell, and its ratio to that of H = 20, L = 4.

    Levels depend on the rows and how they are split; ratios say what width, depth and velocities
    are worth.
    """
    table = load(folder / "table_3.json")
    own = (folder / "flights").exists()
    rows = {row["cell"]: row for row in table["rows"] if row["paper_g2"] is not None}
    base = rows[_BASE]
    found = [_level(name, row, own) for name, row in rows.items()]
    for name, row in rows.items():
        if name != _BASE:
            paper = row["paper_g2"] / base["paper_g2"]
            found.append(
                Row(
                    quantity=f"{name}: error over that of {_BASE}",
                    paper=f"{paper:.3f}",
                    ours=row["ours_g2"] / base["ours_g2"],
                    agrees=about(paper, 0.06),
                    reasons=_reasons(name, own, preset),
                )
            )
    return found


def _level(name: str, row: dict[str, float], own: bool) -> Row:
    deviation = row["ours_deviation_g2"]
    reasons = (
        Reason(
            "other rows: collected in simulation, with its forces, sensors and calibration",
            Range(0.1, 40.0),
        ),
        Reason("the splits differ: 20 s pieces of a scenario there, 5 s blocks here", Range(5, 9)),
    )
    error, spread = row["ours_g2"], row["paper_deviation_g2"]
    return Row(
        quantity=f"{name}: validation error, g²",
        paper=f"{row['paper_g2']:.2f}" + (f" ± {spread:.2f}" if spread else ""),
        ours=error,
        spread=(error - deviation, error + deviation) if deviation else None,
        spread_is="standard deviation" if deviation else "",
        agrees=about(row["paper_g2"], 0.05),
        reasons=reasons if own else reasons[1:],
    )


def _reasons(name: str, own: bool, preset: Preset) -> tuple[Reason, ...]:
    short = Reason("--quick fits 400 steps of one seed: far from the end", Range(0.7, 1.6))
    flat = Reason(
        "with this recipe width and depth matter less; the paper's L = 5 overfits", Range(0.9, 1.15)
    )
    air = Reason("how much the simulated force depends on velocity is its own", Range(0.95, 3.0))
    bare = Reason(
        "simulated rows leave little but the network's own error, a tenth of the paper's, so what "
        "a smaller one cannot form weighs more; on measured rows they differ by 2 % at most",
        Range(0.95, 2.0),
    )
    return (
        *((short,) if preset == "quick" else ()),
        *((air,) if own and name == "no-relative-velocity" else ()),
        *((flat,) if name != "no-relative-velocity" else ()),
        *((bare,) if own and name != "no-relative-velocity" else ()),
    )

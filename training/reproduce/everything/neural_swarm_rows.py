"""What the commands of Neural-Swarm2 measured, beside the paper's numbers."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from swarm_envs.training.reproduce.everything.item import Preset
from swarm_envs.training.reproduce.everything.rows import Range, Reason, Row, about
from swarm_envs.training.reproduce.paired import SIGNIFICANT

_ERROR = 0.3
"""Share by which a height error may miss the paper's, which is one drone's, or a median of six."""
_QUIETER_AIR = (
    "what is left in the hall, vehicles that are not what their model says, estimated states, "
    "batteries and wakes that fluctuate, is not in this air"
)
_OWN_RINGS = "the paper publishes no radii, speeds or phases of its rings; ours are our choice"
_OWN_AIR = "the force that blows here is a model, one of two, and not the air of their hall"


def load(path: Path) -> Any:
    """The content of a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))


def _height_error(
    what: str, side: Mapping[str, float], paper_cm: float, reasons: Sequence[Reason]
) -> Row:
    return Row(
        quantity=what,
        paper=f"{paper_cm:g}",
        ours=side["median"],
        spread=(side["lower_quartile"], side["upper_quartile"]),
        spread_is="quartiles",
        agrees=about(paper_cm, _ERROR),
        reasons=tuple(reasons),
    )


def _compensation(where: str, case: Mapping[str, Any], without: Reason) -> Iterator[Row]:
    """Errors without and with compensation, and their ratio."""
    before, after = case["paper_cm"]
    known = Reason(_QUIETER_AIR, Range(0.0, after))
    yield _height_error(f"{where}: error without, cm", case["without"], before, [without])
    yield _height_error(f"{where}: error with, cm", case["compensated"], after, [known])
    yield Row(
        quantity=f"{where}: error without over error with",
        paper=f"{before / after:.2g}",
        ours=1.0 / case["ratio"],
        agrees=about(before / after, _ERROR),
        reasons=(Reason(_QUIETER_AIR, Range(before / after)),),
    )


def rings(folder: Path, preset: Preset) -> list[Row]:
    """Fig. 1 and 9: the worst drone's height error in both airs, and the force foreseen."""
    figure = 9 if (folder / "figure_9.json").is_file() else 1
    found: list[Row] = []
    for air in load(folder / f"figure_{figure}.json")["truths"]:
        case = air["cases"][0]
        where = f"`{air['truth']['name']}` air"
        found += _compensation(where, case, Reason(_OWN_RINGS, Range(3.0, 25.0)))
        found.append(
            Row(
                quantity=f"{where}: share of the force's variance predicted",
                paper="accurate" if figure == 9 else "relatively less accurate",
                ours=case["explained"],
                agrees=Range(0.9 if figure == 9 else 0.5),
            )
        )
    return found


def swaps(folder: Path, preset: Preset) -> list[Row]:
    """Fig. 8: the one median that the paper prints, and its two claims about all cases."""
    found: list[Row] = []
    for air in load(folder / "figure_8.json")["truths"]:
        where, cases = f"`{air['truth']['name']}` air", air["cases"]
        (l2s,) = (case for case in cases if case["case"] == "L2S")
        found += _compensation(f"{where}, L2S", l2s, Reason(_OWN_AIR, Range(8.5, 34.0)))
        better = [case for case in cases if case["ratio"] < 1.0]
        sure = [case for case in better if case["p_value"] < SIGNIFICANT]
        found.append(
            Row(
                quantity=f"{where}: share of cases whose median improves",
                paper="all",
                ours=len(better) / len(cases),
                agrees=Range(1.0, 1.0),
            )
        )
        found.append(
            Row(
                quantity=f"{where}: share of cases that improve with p < {SIGNIFICANT:g}",
                paper="most",
                ours=len(sure) / len(cases),
                agrees=Range(0.5, 1.0),
            )
        )
    return found


def heat_maps(folder: Path, preset: Preset) -> list[Row]:
    """Fig. 5: the three numbers that the text reads off it."""
    spare = "the authors' own published weights say {:+.1f} g here; nothing is tuned to the figure"
    return [
        Row(
            quantity=f"{reading['what']}, g",
            paper=f"{reading['paper_g']:+g}",
            ours=reading["ours_g"],
            agrees=about(reading["paper_g"], 0.25),
            reasons=(
                Reason(
                    spare.format(reading["published_weights_g"]),
                    Range(*sorted((0.0, reading["paper_g"]))),
                ),
            ),
        )
        for reading in load(folder / "figure_5.json")["readings"]
    ]


def planned_swap(folder: Path, preset: Preset) -> list[Row]:
    """Fig. 6: forces of both plans against their bounds, and who passes above whom."""
    content = load(folder / "figure_6.json")

    def worst(planner: str, token: str, what: str = "model_plant_force_g") -> float:
        own = [r for r in content["rows"] if r["planner"] == planner and r["vehicle"] == token]
        return max(float(r[what]) for r in own)

    def errors(planner: str) -> float:
        return max(worst(planner, token, "model_plant_error_cm") for token in "SL")

    orders = content["orders"]["aware"]
    optimum = Reason(
        "a plan is a local optimum: some seeds pass a small robot 0.6 m beneath, at much the same "
        "cost",
        Range(0.0, 0.5),
    )
    shorter = Reason("our starts and goals are not theirs, which are not published", Range(1.0))
    return [
        Row(
            quantity="aware plan: force on a small robot, g",
            paper="very small, bound 5",
            ours=worst("aware", "S"),
            agrees=Range(0.0, 5.0),
        ),
        Row(
            quantity="aware plan: force on the large robot, g",
            paper="within the bound of 10",
            ours=worst("aware", "L"),
            agrees=Range(0.0, 10.0),
        ),
        Row(
            quantity="aware plan: worst tracking error, cm",
            paper="not significant",
            ours=errors("aware"),
            agrees=Range(0.0, 2.0),
        ),
        Row(
            quantity="unaware plan: force on a small robot, g",
            paper="beyond the bound of 5",
            ours=worst("unaware", "S"),
            agrees=Range(5.0),
        ),
        Row(
            quantity="unaware plan: worst tracking error, cm",
            paper="significant",
            ours=errors("unaware"),
            agrees=Range(5.0),
            reasons=(shorter,),
        ),
        Row(
            quantity="share of aware plans that send the large robot below",
            paper="1 of 1",
            ours=orders.get("L below S", 0) / sum(orders.values()),
            agrees=Range(0.51, 1.0),
            reasons=(optimum,),
        ),
    ]


def planned_trials(folder: Path, preset: Preset) -> list[Row]:
    """Fig. 7: what the text says of it."""
    rows = load(folder / "figure_7.json")["rows"]["model_plant"]
    by = {(row["scenario"], row["planner"]): row for row in rows}
    unaware = [row for row in rows if row["planner"] == "unaware"]
    aware = [row for row in rows if row["planner"] == "aware"]
    drawn = Reason(
        "the swaps are drawn anew; those of the paper are not published", Range(1.2, 3.0)
    )
    found = [
        Row(
            quantity=f"{team}, unaware: worst force over its bound",
            paper="nearly double",
            ours=by[team, "unaware"]["worst_over_bound"],
            agrees=Range(1.6, 2.4),
            reasons=(drawn,),
        )
        for team in ("SL", "SSL", "LL")
        if (team, "unaware") in by
    ]
    small = by["SL", "unaware"]["worst_force_S_g"]
    return [
        *found,
        Row(
            quantity="SL, unaware: worst force on the small robot, g",
            paper="greater than 10",
            ours=small,
            agrees=Range(10.0),
            reasons=(drawn,) if small > 6.0 else (),
        ),
        Row(
            quantity="unaware: worst tracking error of all scenarios, cm",
            paper="over 10",
            ours=max(row["worst_error_cm"] for row in unaware),
            agrees=Range(10.0),
        ),
        Row(
            quantity="aware: worst force over its bound, all scenarios",
            paper="at most 1",
            ours=max(row["worst_over_bound"] for row in aware),
            agrees=Range(0.0, 1.0),
        ),
        Row(
            quantity="aware: worst tracking error of all scenarios, cm",
            paper="-",
            ours=max(row["worst_error_cm"] for row in aware),
        ),
    ]

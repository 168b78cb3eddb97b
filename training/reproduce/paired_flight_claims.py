"""What Fig. 8, 9 and 1 of Neural-Swarm2 claim, held against the flights of both worlds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from swarm_envs.training.reproduce.claims import Between, Claim, Extent, Reason, about, exactly
from swarm_envs.training.reproduce.paired_flights import SIGNIFICANT

_ERROR = 1.0 / 3.0  # a height error may miss the paper's, of one drone or six swaps, by this share
_QUIETER_AIR = (
    "what is left in the hall, vehicles that are not what their model says, estimated states, "
    "batteries and wakes that fluctuate, is not in this air"
)
_OWN_RINGS = Reason(
    "the paper publishes no radii, speeds or phases of its rings; ours are our choice",
    Between(3.0, 25.0),
)
_OWN_AIR = Reason(
    "the force here is that of a model, one of two, and not of the air of their hall",
    Between(8.5, 34.0),
)


def _place_of(air: Mapping[str, Any]) -> str:
    """Where a case was flown, as claims say it."""
    return f"`{air['truth']['name']}` air" + (", hall" if air["world"] == "hall" else "")


def _compensation(
    air: Mapping[str, Any], case: Mapping[str, Any], where: str, without: Reason
) -> Iterator[Claim]:
    """Errors without and with compensation, and their ratio; in the hall nothing is explained away.

    Only the error without compensation follows from the layout and the force; the others may be
    smaller in the ideal world, which has nothing of what compensation does not know.
    """
    before, after = case["paper_cm"]
    quieter = air["world"] == "ideal"
    known = (Reason(_QUIETER_AIR, Between(0.0, after)),) if quieter else ()
    for side, key, paper, reasons in (
        ("without", "without", before, (without,)),
        ("with", "compensated", after, known),
    ):
        yield Claim(
            f"{where}: error {side}, cm",
            f"{paper:g}",
            case[key]["median"],
            about(paper, _ERROR),
            reasons,
            spread=(case[key]["lower_quartile"], case[key]["upper_quartile"]),
            spread_is="quartiles",
        )
    yield Claim(
        f"{where}: error without over error with",
        f"{before / after:.2g}",
        1.0 / case["ratio"],
        about(before / after, _ERROR),
        (Reason(_QUIETER_AIR, Between(before / after)),) if quieter else (),
    )


def ring_claims(numbers: Any, extent: Extent) -> Iterator[Claim]:
    """Fig. 1 and 9: the worst drone's height error in each air, and the force foreseen."""
    for air in numbers["truths"]:
        where, (case, *others) = _place_of(air), air["cases"]
        yield from _compensation(air, case, where, _OWN_RINGS)
        if not others:  # the rings of 5
            yield Claim(
                f"{where}: share of the force's variance predicted",
                "accurate",
                case["explained"],
                Between(0.9),
            )
        for five in others:
            yield Claim(
                f"{where}: share of the force's variance predicted, less that of 5 drones",
                "relatively less accurate",
                case["explained"] - five["explained"],
                Between(-1.0, 0.0),
            )


def swap_claims(numbers: Any, extent: Extent) -> Iterator[Claim]:
    """Fig. 8: the one median that the paper prints, and its two claims about all cases."""
    for air in numbers["truths"]:
        where, cases = _place_of(air), air["cases"]
        (l2s,) = (case for case in cases if case["case"] == "L2S")
        yield from _compensation(air, l2s, f"{where}, L2S", _OWN_AIR)
        better = [case for case in cases if case["ratio"] < 1.0]
        sure = [case for case in better if case["p_value"] < SIGNIFICANT]
        yield Claim(
            f"{where}: share of cases whose median improves",
            "all",
            len(better) / len(cases),
            exactly(1.0),
        )
        yield Claim(
            f"{where}: share of cases that improve with p < {SIGNIFICANT:g}",
            "most",
            len(sure) / len(cases),
            Between(0.5, 1.0),
        )

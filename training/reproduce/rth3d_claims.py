"""What the RTH3D paper says of its Fig. 5 to 9, held against the curves that were measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from swarm_envs.training.reproduce.claims import Between, Claim, Extent, Reason
from swarm_envs.training.reproduce.rth3d_runs import GUARANTEED, PUBLISHED


def _points(numbers: Any, series: str, method: str) -> list[dict[str, Any]]:
    """The points of one curve, from the smallest grid to the largest."""
    own = [p for p in numbers["points"] if (p["series"], p["method"]) == (series, method)]
    if not own:
        raise ValueError(f"there is no curve of {method!r} on {series!r}")
    return own


def _ratio_claim(
    point: Mapping[str, Any],
    paper: str = "-",
    agrees: Between | None = None,
    reasons: tuple[Reason, ...] = (),
    column: str = "ratio_before_compaction",
) -> Claim:
    several, before = point["runs"] > 1, " before compaction" if column != "ratio" else ""
    return Claim(
        f"{point['series']} {point['grid'].replace('x', ' x ')}, `{point['method']}`: "
        f"ratio{before}",
        paper,
        point[column],
        agrees,
        reasons,
        spread=(point[f"{column}_least"], point[f"{column}_most"]) if several else None,
        spread_is="least and largest",
    )


def _auto_claim(numbers: Any, series: str) -> Claim:
    """Our best method, which the paper does not have."""
    return _ratio_claim(_points(numbers, series, "auto")[-1], column="ratio")


def _falls_claim(numbers: Any, series: str, method: str) -> Claim:
    curve, column = _points(numbers, series, method), "ratio_before_compaction"
    return Claim(
        f"{series}, `{method}`: ratio on the largest grid over the smallest",
        "decreases with size",
        curve[-1][column] / curve[0][column],
        Between(0.0, 1.0),
    )


def _small_grids(extent: Extent, above: float) -> tuple[Reason, ...]:
    """Why ratios may lie above a value that only small grids have."""
    said = "ratios fall as grids grow, and --quick leaves the large ones out"
    return (Reason(said, Between(above, 2.3)),) if extent.quick else ()


def slab_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Fig. 5: about 1.7 and 1.5 at the largest size, falling."""
    shorter = Reason(
        "balancing takes the fewest steps possible here, instead of the least distance",
        Between(1.0, 1.7),
    )
    fewer = Reason("--quick leaves the large grids out", Between(1.0))
    return [
        *(
            _ratio_claim(
                _points(numbers, "uniform", method)[-1],
                f"about {value:g}",
                Between(value - 0.1, value + 0.05),
                (*_small_grids(extent, value), shorter),
            )
            for method, value in zip(PUBLISHED, (1.7, 1.5), strict=True)
        ),
        _ratio_claim(_points(numbers, "uniform", "rth3d-lba")[-1]),
        *(_falls_claim(numbers, "uniform", method) for method in GUARANTEED),
        Claim(
            "robots on the largest grid",
            "over 120,000",
            _points(numbers, "uniform", "rth3d-lba-paper")[-1]["robots"],
            Between(120_000),
            (fewer,) if extent.quick else (),
        ),
        _auto_claim(numbers, "uniform"),
    ]


def flat_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Fig. 6: towards 1.5 on flat grids."""
    below = Reason(
        "shifts of bounded matchings are shorter than the sides, so that it passes below what the "
        "theory guarantees",
        Between(1.0, 1.5),
    )
    above = Reason(
        "it has not come down to its asymptote on the grids that we ran", Between(1.5, 2)
    )
    return [
        *(
            _ratio_claim(
                _points(numbers, "uniform", method)[-1],
                "asymptotically 1.5",
                Between(1.4, 1.6),
                (*_small_grids(extent, 1.5), below, above),
            )
            for method in PUBLISHED
        ),
        _ratio_claim(_points(numbers, "uniform", "rth3d-lba")[-1]),
        *(_falls_claim(numbers, "uniform", method) for method in GUARANTEED),
        _auto_claim(numbers, "uniform"),
    ]


def building_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Fig. 7: between buildings the paper shows curves alone."""
    return [
        *(_ratio_claim(_points(numbers, "buildings", method)[-1]) for method in GUARANTEED),
        *(_falls_claim(numbers, "buildings", method) for method in GUARANTEED),
        _auto_claim(numbers, "buildings"),
    ]


def density_claims(numbers: Any, extent: Extent) -> Iterator[Claim]:
    """Fig. 8: density has little impact on time, and ratios are better."""
    cheaper = Reason(
        "nothing is written of virtual robots and they are not compacted, so that few robots cost "
        "less than many",
        Between(2.0, 20.0),
    )
    for method in GUARANTEED:
        # The authors' sweep begins with 4,800 robots.
        curve = [p for p in _points(numbers, "uniform", method) if p["robots"] >= 4800]
        first, last, column = curve[0], curve[-1], "ratio_before_compaction"
        yield Claim(
            f"`{method}`: time for {last['robots']:,} robots over {first['robots']:,}",
            "little impact",
            last["cpu_s"] / first["cpu_s"],
            Between(0.5, 2.0),
            (cheaper,),
        )
        yield Claim(
            f"`{method}`: ratio for {last['robots']:,} robots over {first['robots']:,}, before "
            "compaction",
            "better with density",
            last[column] / first[column],
            Between(0.0, 1.0),
        )


def pattern_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Fig. 9: rings approach 1."""
    rings, method = "rings, 2m x 2m x m", "rth3d-lba-paper"
    early = Reason("ratios fall as grids grow, and --quick ends early", Between(1.0, 1.35))
    blocks = ("27 blocks, m x m x m", "3 x 3 x 3 blocks, 2m x 2m x m")
    last = _points(numbers, rings, method)[-1]
    known = (early,) if extent.quick else ()
    return [
        _ratio_claim(last, "approaches 1", Between(1.0, 1.15), known),
        _falls_claim(numbers, rings, method),
        *(_ratio_claim(_points(numbers, series, method)[-1]) for series in blocks),
        _auto_claim(numbers, blocks[0]),
    ]

"""The belief's model card, written from its report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarm_envs.training.collection.table import ROW_RATE

if TYPE_CHECKING:
    from swarm_envs.training.belief.fit import BeliefReport
    from swarm_envs.training.belief.judge import SwapJudgement
    from swarm_envs.training.collection.config import CollectionConfig
    from swarm_envs.training.force_model.network import InputRange

_CARD = """\
# `{name}.safetensors`: the deep set that the compensated controller believes

**Fitted to simulated flights, not to measured ones.** Drones were flown inside the environment
with the force model `{interactions}` (fingerprint `{interactions_sha256}`), and the force was
computed from what they logged, as for real ones. The controller that believes this network never
reads the environment's own model; how well it does says nothing about real air beyond what the
environment's model says about it. When `{interactions}` changes, make this again.

    {command}

{wall_time_s:.0f} s on one core: flights, fit, judgement. The same seed gives the same flights.

## Flights
{flights} flights, {flown_s:.0f} s, teams {teams}: per team {walks} random walks aloft and
{low_walks} near the ground, and in company {swaps} stacked swaps aloft and {low_swaps} near the
ground, {duration_s:g} s each unless the team touches something: the log ends before. Every fifth
flight of a team and kind is held out. The pilot does not compensate.

The log, at 120 Hz, has position, velocity, attitude and rotor *commands*; white noise of
{position_mm:g} mm, {velocity_cm:g} cm/s and {attitude_mrad:g} mrad is added to what sensors see.
f_a = m a + m g k - R T k, with a by five-point differentiation of the logged velocity and T by the
motor lag (eq. 1c) of the logged commands, averaged over 0.1 s. {rows} rows at {row_rate} Hz: all of
lone drones; of others those with a neighbour in the interaction volume.

## Network
The paper's shapes and spectral clip, fading window, inputs clamped to the flown range, anchored: a
drone at or above 0.6 m that has no neighbour in its interaction volume feels exactly nothing but
linear drag. {steps} steps of Adam.

## Validation
Mean squared error of the vertical force on the held-out flights, labels as noisy as those of the
training, g^2:

| scenario | this | zero | scenario mean |
|---|---|---|---|
{errors}

## In flight
Stacked swaps on the compiled engine, worst height error of the lowest drone, medians; the same
seeds, gains and references with and without. "Worse": episodes in which compensation made it
larger. "Upper": the largest growth of any other drone's worst height error, cm.

| team | radius, m | time, s | episodes | without, cm | with | largest ratio | worse | upper |
|---|---|---|---|---|---|---|---|---|
{judgements}

## Where not to trust it
Outside the flown range, where inputs are clamped, so that the force stays what it is at the edge:
sideways beyond {own_speed:g} m/s, or {pair_speed:g} m/s relative to a neighbour; heights below
{lowest:g} m. And with more than two neighbours in one interaction volume: nobody flew that.
"""


def model_card(report: BeliefReport, collection: CollectionConfig, limits: InputRange) -> str:
    """The card of a belief, in Markdown.

    Args:
        report: what was fitted, and how it does.
        collection: what was flown.
        limits: range of inputs of the network.
    """
    noise = collection.noise
    return _CARD.format(
        name=report.name,
        interactions=report.interactions,
        interactions_sha256=report.interactions_sha256[:16],
        command=report.command,
        wall_time_s=report.wall_time_s,
        flights=report.flights,
        flown_s=report.flown_s,
        rows=report.rows,
        row_rate=ROW_RATE,
        teams=", ".join(collection.teams),
        walks=collection.walks,
        low_walks=collection.low_walks,
        swaps=collection.swaps,
        low_swaps=collection.low_swaps,
        duration_s=collection.duration_s,
        position_mm=1e3 * noise.position_m,
        velocity_cm=1e2 * noise.velocity,
        attitude_mrad=1e3 * noise.attitude_rad,
        steps=report.fit.history[-1]["step"],
        errors=_errors(report),
        judgements="\n".join(_judgement(j) for j in report.judgements),
        pair_speed=limits.pair[1][3],
        own_speed=limits.environment[1][1],
        lowest=-limits.environment[1][0],
    )


def _errors(report: BeliefReport) -> str:
    e = report.fit.findings.errors
    rows = [("all", e.overall, e.zero, e.scenario_mean)]
    rows += [
        (name, value, e.scenario_zero[name], e.scenario_scenario_mean[name])
        for name, value in e.scenario.items()
    ]
    return "\n".join(f"| {n} | {a:.2f} | {b:.2f} | {c:.2f} |" for n, a, b, c in rows)


def _judgement(j: SwapJudgement) -> str:
    low, high = j.layout.radius_m
    fast, slow = j.layout.duration_s
    cells = (
        j.team,
        f"{low:g}-{high:g}",
        f"{fast:g}-{slow:g}",
        j.episodes,
        f"{j.uncompensated_median_cm:.1f}",
        f"{j.compensated_median_cm:.1f}",
        f"{j.largest_ratio:.2f}",
        j.worse,
        f"{j.upper_largest_growth_cm:.1f}",
    )
    return "| " + " | ".join(map(str, cells)) + " |"

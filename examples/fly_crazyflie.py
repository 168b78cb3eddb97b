"""Fly what `swarm-envs export trajectory` wrote on real Crazyflies: `pip install cflib` first.

    python examples/fly_crazyflie.py FOLDER --uris uris.json            # checks, does not take off
    python examples/fly_crazyflie.py FOLDER --uris uris.json --fly

`uris.json` says who is who: {"drone_0": "radio://0/80/2M/E7E7E7E701", ...}. Every drone must stand
below the start of its trajectory, in a positioning system with the simulation's axes. Read
docs/deploy.md before. Ctrl-C lands everyone where they are.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.deploy import Pieces, evaluate, read_pieces

TRAJECTORY_ID = 1
NEAR_M, LEAST_VOLT = 0.15, 3.9
TAKE_OFF_S, GO_TO_S, LAND_S = 2.5, 2.5, 3.0


def load(folder: Path, uris: dict[str, str]) -> dict[str, Pieces]:
    """Trajectories by URI; the report says which drones there are, whatever else lies around."""
    names = [drone["name"] for drone in json.loads((folder / "report.json").read_text())["drones"]]
    if set(names) != set(uris) or len(set(uris.values())) != len(uris):
        raise SystemExit(f"name one URI for each of {', '.join(names)}, but given: {uris}")
    return {uris[name]: read_pieces(folder / f"{name}.csv") for name in names}


def to_cflib(pieces: Pieces) -> list[Any]:
    """Elements of cflib's trajectory memory."""
    from cflib.crazyflie.mem import Poly4D

    return [
        Poly4D(float(duration), *(Poly4D.Poly([float(value) for value in axis]) for axis in axes))
        for duration, axes in zip(pieces.duration, pieces.coefficients, strict=True)
    ]


def upload(scf: Any, pieces: Pieces) -> None:
    """Write a trajectory into a drone's memory, and define it."""
    from cflib.crazyflie.mem import MemoryElement

    memory = scf.cf.mem.get_mems(MemoryElement.TYPE_TRAJ)[0]
    memory.trajectory = to_cflib(pieces)
    if not memory.write_data_sync():
        raise RuntimeError(f"{scf.cf.link_uri} did not take its trajectory")
    scf.cf.high_level_commander.define_trajectory(TRAJECTORY_ID, 0, len(pieces))


def check(swarm: Any, trajectories: dict[str, Pieces]) -> None:
    """Refuse to take off with drones in wrong places."""
    for uri, (x, y, z) in swarm.get_estimated_positions().items():
        start = evaluate(trajectories[uri], 0.0)
        gap = np.hypot(x - start[0], y - start[1])
        print(f"{uri}: {gap * 100:.0f} cm beside its start, which is {start[2] - z:.2f} m above it")
        if not (gap <= NEAR_M and start[2] - z > 0.0):
            raise SystemExit(f"put it below ({start[0]:.2f}, {start[1]:.2f}) and begin again")


def check_battery(scf: Any) -> None:
    """Refuse to take off with an empty battery: its voltage falls under load."""
    from cflib.crazyflie.log import LogConfig
    from cflib.crazyflie.syncLogger import SyncLogger

    config = LogConfig(name="battery", period_in_ms=100)
    config.add_variable("pm.vbat", "float")
    with SyncLogger(scf, config) as logger:
        volt = next(iter(logger))[1]["pm.vbat"]
    if not volt >= LEAST_VOLT:
        raise RuntimeError(f"{scf.cf.link_uri} has {volt:.2f} V left; charge it first")


def fly(
    swarm: Any, trajectories: dict[str, Pieces], sleep: Callable[[float], None] = time.sleep
) -> None:
    """Take off one by one, the highest first; fly together; land one by one, the lowest first."""
    duration = max(pieces.total_s for pieces in trajectories.values())
    starts = {uri: evaluate(pieces, 0.0) for uri, pieces in trajectories.items()}
    ends = {uri: evaluate(pieces, pieces.total_s) for uri, pieces in trajectories.items()}
    commander = {uri: scf.cf.high_level_commander for uri, scf in swarm._cfs.items()}
    try:
        for uri in sorted(starts, key=lambda uri: -starts[uri][2]):
            cf = swarm._cfs[uri].cf  # cflib before 2026 arms through its platform
            (getattr(cf, "supervisor", None) or cf.platform).send_arming_request(True)
            sleep(1.0)
            commander[uri].takeoff(float(starts[uri][2]), TAKE_OFF_S)
            sleep(TAKE_OFF_S)
            commander[uri].go_to(*map(float, starts[uri]), GO_TO_S)
            sleep(GO_TO_S)
        swarm.parallel_safe(lambda scf: scf.cf.high_level_commander.start_trajectory(TRAJECTORY_ID))
        sleep(duration + 1.0)
        for uri in sorted(ends, key=lambda uri: ends[uri][2]):
            commander[uri].land(0.0, LAND_S)
            sleep(LAND_S)
            commander[uri].stop()
    except BaseException:
        for one in commander.values():
            one.land(0.0, LAND_S)
        sleep(LAND_S)
        raise
    finally:
        for one in commander.values():
            one.stop()


def main(arguments: list[str] | None = None) -> None:
    """Connect, check, upload, and fly if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="what `swarm-envs export trajectory` wrote")
    parser.add_argument("--uris", type=Path, required=True, help="JSON: URI of each drone")
    parser.add_argument("--fly", action="store_true", help="take off; else only check and upload")
    options = parser.parse_args(arguments)
    trajectories = load(options.folder, json.loads(options.uris.read_text()))
    try:
        import cflib.crtp
        from cflib.crazyflie.swarm import CachedCfFactory, Swarm
    except ImportError:
        sys.exit("this needs cflib; install it by: pip install cflib")
    cflib.crtp.init_drivers()
    with Swarm(trajectories, factory=CachedCfFactory(rw_cache="./cache")) as swarm:
        swarm.reset_estimators()
        swarm.parallel_safe(check_battery)
        check(swarm, trajectories)
        swarm.parallel_safe(upload, {uri: [pieces] for uri, pieces in trajectories.items()})
        if options.fly:
            fly(swarm, trajectories)


if __name__ == "__main__":
    main()

"""Python's time for a frame of the live viewer, with a page that reads all of them.

python -m benchmarks.live
"""

from __future__ import annotations

import threading
import time
import urllib.request
from typing import Any

import gymnasium

from swarm_envs.viewing.live import LiveViewer

_NAME = "swarm_envs:swarm_envs/Swap-v1"  # Gymnasium imports what is before the colon


def milliseconds_a_frame(num_envs: int = 16, num_drones: int = 16, frames: int = 500) -> float:
    """Mean CPU time of the process for a frame, ms: packing, sending, and the reader's own."""
    envs: Any = gymnasium.make_vec(_NAME, num_envs=num_envs, num_drones=num_drones)
    envs.reset(seed=0)
    viewer = LiveViewer(envs.unwrapped.core)
    events = urllib.request.urlopen(viewer.url.replace("/?", "/events?"))
    threading.Thread(target=events.read, daemon=True).start()
    viewer.show()
    started = time.process_time()
    for _ in range(frames):
        viewer.send()
    spent = time.process_time() - started
    viewer.close()
    envs.close()
    return 1e3 * spent / frames


if __name__ == "__main__":
    print(f"live viewer, 16 environments of 16 drones: {milliseconds_a_frame():.2f} ms a frame")

"""Who shares the work: processes of this machine, or a Ray cluster, by the options of a command."""

from __future__ import annotations

import re
import socket
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Any

from swarm_envs.arguments import Count, typed
from swarm_envs.training.scale_out.jobs import RETRIES, LocalWorkers, Serial, WorkerPool, answer

__all__ = ["ScaleOptions"]

LOCAL, AUTO = "local", "auto"
"""Names of clusters: one of this machine, and whichever is there."""
_ADDRESS = re.compile(r"(ray://)?(?P<host>[^\s/:]+):(?P<port>\d{1,5})")
_REACHED_S = 10.0  # How long an address may take to answer; Ray itself would try for minutes
_AHEAD = 2
"""Jobs handed to Ray for each of its processors: while one is done the next is on its way."""


@partial(typed, owner="--")
@dataclass(frozen=True, kw_only=True)
class ScaleOptions:
    """Who shares the work; the results are the same."""

    workers: Count = 1
    """number of local processes"""
    ray: str | None = None
    """run on a Ray cluster: `auto` for the running one, `local` for a new one on this machine (with
    --workers processors, if more than 1), or an address, such as 10.0.0.1:6379"""

    def __post_init__(self) -> None:
        """Check what the annotations cannot say."""
        if self.ray is not None:
            check_address(self.ray)
        if self.ray is not None and self.workers > 1 and self.ray != LOCAL:
            raise ValueError(
                f"--workers is {self.workers}, but with --ray {self.ray} the cluster says how many "
                "there are; leave it out"
            )

    @property
    def alone(self) -> bool:
        """Whether this process does everything."""
        return self.ray is None and self.workers == 1

    def open(self) -> WorkerPool:
        """The workers that the options ask for; close them, or use them in a `with`.

        Raises:
            ImportError: a cluster is asked for, and Ray is not installed.
            ConnectionError: there is no such cluster.
        """
        if self.ray is not None:
            return RayWorkers(self.ray, self.workers if self.workers > 1 else None)
        if self.alone:
            return Serial()
        return LocalWorkers(self.workers)


class RayWorkers(WorkerPool):
    """The processors of a Ray cluster, each job on one.

    Jobs whose process or node dies are restarted elsewhere by Ray. Nodes that join are used. All
    need swarm-envs of this version. A connection that the process has is used, and left as it was.

    Args:
        address: `auto`, the cluster that runs on this machine or that `RAY_ADDRESS` names; `local`,
            one of this machine alone, which ends with this; or host:port, or ray://host:port.
        cpus: processors of a local one; all if None.

    Raises:
        ImportError: Ray is not installed.
        ConnectionError: there is no cluster at this address.
        ValueError: this is no address.
    """

    def __init__(self, address: str, cpus: int | None = None) -> None:
        check_address(address)
        self._ray = _import_ray()
        self._ours = not self._ray.is_initialized()
        if self._ours:
            _connect(self._ray, address, cpus)
        self._answer = self._ray.remote(num_cpus=1, max_retries=RETRIES)(answer)
        self._given: set[Any] = set()

    @property
    def size(self) -> int:
        """Twice the processors that the cluster has now."""
        return max(1, _AHEAD * int(self._ray.cluster_resources().get("CPU", 1)))

    def submit(self, request: str) -> Future[str]:
        """Hand the job to Ray."""
        reference = self._answer.remote(request)
        self._given.add(reference)
        future: Future[str] = reference.future()
        future.add_done_callback(lambda _: self._given.discard(reference))
        return future

    def close(self) -> None:
        """Cancel what is under way, and leave the cluster if this joined it."""
        for reference in list(self._given):
            self._ray.cancel(reference, force=True)
        if self._ours:
            self._ray.shutdown()


def check_address(address: str) -> None:
    """Refuse what is no address of a cluster."""
    if address not in (LOCAL, AUTO) and not _ADDRESS.fullmatch(address):
        raise ValueError(
            f"--ray is {address!r}, but must be {AUTO!r}, {LOCAL!r}, or host:port such as "
            "10.0.0.1:6379 or ray://10.0.0.1:10001"
        )


def _import_ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise ImportError(
            "a cluster needs Ray; install it by: pip install 'swarm-envs[ray]' (or share the work "
            "among processes of this machine by --workers, without Ray)"
        ) from error
    return ray


def _connect(ray: Any, address: str, cpus: int | None) -> None:
    given: dict[str, Any] = {"log_to_driver": False, "logging_level": "WARNING"}
    if address == LOCAL:
        given |= {"num_cpus": cpus, "include_dashboard": False}
    try:
        named = _ADDRESS.fullmatch(address)
        if named:
            place = named["host"], int(named["port"])
            socket.create_connection(place, timeout=_REACHED_S).close()
        ray.init(address=address, **given)
    except OSError as error:
        raise ConnectionError(
            f"no Ray cluster was found at {address!r} ({error}); begin one by `ray start --head`, "
            f"name its address, or say {LOCAL!r} for one on this machine alone"
        ) from error

"""Where the work is done, as commands are told."""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.errors import check_integer
from swarm_envs.training.scale_out.cluster import LOCAL, RayWorkers, check_address
from swarm_envs.training.scale_out.jobs import Serial, Workers
from swarm_envs.training.scale_out.local import LocalWorkers


@dataclass(frozen=True, kw_only=True)
class ScaleOptions:
    """Who shares the work; the results are the same."""

    workers: int = 1
    """processes of this machine; 1 for this one alone"""
    ray: str | None = None
    """a Ray cluster does it: `auto` for the one that runs here, `local` for one on this machine
    alone (of --workers processors, if more than 1), or its address, such as 10.0.0.1:6379"""

    def __post_init__(self) -> None:
        """Refuse what cannot be.

        Raises:
            ValueError: naming the option, the value and the rule.
        """
        check_integer("--workers", self.workers, 1)
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

    def open(self) -> Workers:
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

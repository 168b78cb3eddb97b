"""Jobs over a real Ray cluster of several nodes, one of which is killed."""

from __future__ import annotations

import os
import socket
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

pytest.importorskip("ray")

import ray
from ray.cluster_utils import Cluster

from swarm_envs.training.scale_out import ScaleOptions, run_jobs
from tests.helpers.small_jobs import alive, small_job, wait_for

# Nothing is told to anybody; and nodes have time to begin where others use the processors.
os.environ.update({"RAY_USAGE_STATS_ENABLED": "0", "RAY_raylet_start_wait_time_s": "120"})
NODE = {"num_cpus": 1, "object_store_memory": 80 * 2**20}


@pytest.fixture
def cluster():
    """Provide a node of one processor, to which others can be added; a dead one is missed soon."""
    soon = {"health_check_period_ms": 500, "health_check_failure_threshold": 4}
    head = {**NODE, "include_dashboard": False, "_system_config": soon}
    made = Cluster(initialize_head=True, head_node_args=head)
    try:
        yield made
    finally:
        ray.shutdown()
        made.shutdown()


@pytest.mark.slow
def test_a_node_dies_and_every_result_is_there_once(cluster, tmp_path):
    """Both nodes are at a long job when the second is killed; the first does all that is left."""
    victim, notes = cluster.add_node(**NODE), tmp_path / "notes"
    notes.mkdir()
    jobs: list[Any] = [(name, ("waits", notes)) for name in "ab"]
    jobs += [(k, ("square", 0.1 * k)) for k in range(30)]
    expected: dict[Any, Any] = {k: (0.1 * k) * (0.1 * k) / 3.0 for k in range(30)}
    expected |= {"a": "waited", "b": "waited"}

    def kill_when_both_are_busy() -> None:
        wait_for(lambda: len(list(notes.iterdir())) == 2)
        cluster.remove_node(victim, allow_graceful=False)
        wait_for(lambda: not all(map(alive, notes.iterdir())))
        (tmp_path / "gate").touch()

    with ThreadPoolExecutor(1) as other:
        killed = other.submit(kill_when_both_are_busy)
        results = list(run_jobs(small_job, jobs, ScaleOptions(ray=cluster.address)))
        killed.result()
    assert len(results) == len(expected)
    assert dict(results) == expected
    assert len([*notes.iterdir()]) == 3  # the dead node's was begun anew


@pytest.mark.slow
def test_what_runs_on_a_cluster_ends_with_the_results(cluster, tmp_path):
    notes = tmp_path / "notes"
    notes.mkdir()
    jobs = [("quick", ("square", 3.0)), ("long", ("waits", notes))]
    results = run_jobs(small_job, jobs, ScaleOptions(ray=cluster.address))
    assert next(results) == ("quick", 3.0)
    wait_for(lambda: [*notes.iterdir()])
    results.close()
    wait_for(lambda: not any(map(alive, notes.iterdir())))


def test_where_nobody_listens_is_said_at_once():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"  # bound, so that nobody else listens there
        with pytest.raises(ConnectionError, match="no Ray cluster was found at '127"):
            next(run_jobs(small_job, [(0, ("square", 1.0))], ScaleOptions(ray=address)))

"""Jobs over a real Ray cluster of several nodes, one of which is killed in the middle."""

from __future__ import annotations

import os
import socket
from collections import deque
from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("ray")

import ray
from ray.cluster_utils import Cluster

from swarm_envs.training.scale_out.jobs import Job, Serial
from swarm_envs.training.scale_out.options import RayWorkers
from tests.helpers import small_jobs
from tests.helpers.small_jobs import alive, wait_for

# Nothing is told to anybody; and nodes have time to begin where others use the processors.
os.environ.update({"RAY_USAGE_STATS_ENABLED": "0", "RAY_raylet_start_wait_time_s": "120"})
HERE = small_jobs.__name__
NODE = {"num_cpus": 1, "object_store_memory": 80 * 2**20}


@pytest.fixture
def cluster():
    """A node of one processor, on which others can be set up; a dead one is missed soon."""
    soon = {"health_check_period_ms": 500, "health_check_failure_threshold": 4}
    head = {**NODE, "include_dashboard": False, "_system_config": soon}
    made = Cluster(initialize_head=True, head_node_args=head)
    try:
        yield made
    finally:
        ray.shutdown()
        made.shutdown()


def test_a_node_dies_and_every_result_is_there_once(cluster, tmp_path):
    """Both nodes are at a long job when the second is killed; the first does all that is left."""
    victim, notes, gate = cluster.add_node(**NODE), tmp_path / "notes", tmp_path / "gate"
    notes.mkdir()
    given = {"folder": str(notes), "gate": str(gate)}
    long = [Job(f"{HERE}:waits", {**given, "name": name}, name) for name in "ab"]
    jobs = [Job(f"{HERE}:square", {"value": 0.1 * k}, f"{k}") for k in range(30)]
    jobs += [Job(f"{HERE}:fails", {"value": 1.0}, "bad")]
    expected = {o.job.label: (o.result, o.error) for o in Serial().run(deque(jobs))}
    expected |= {"a": ("a", None), "b": ("b", None)}

    def kill_when_both_are_busy() -> None:
        wait_for(lambda: len(list(notes.iterdir())) == 2)
        cluster.remove_node(victim, allow_graceful=False)
        wait_for(lambda: not all(map(alive, notes.iterdir())))
        gate.touch()

    with RayWorkers(cluster.address) as workers, ThreadPoolExecutor(1) as other:
        killed = other.submit(kill_when_both_are_busy)
        outcomes = list(workers.run(deque([*long, *jobs])))
        killed.result()
    assert len(outcomes) == len(expected)
    assert {o.job.label: (o.result, o.error) for o in outcomes} == expected
    names = [note.name[0] for note in notes.iterdir()]
    assert sorted(names) in (["a", "a", "b"], ["a", "b", "b"])  # the dead node's was begun anew


def test_where_nobody_listens_is_said_at_once():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"  # bound, so that nobody else listens there
        with pytest.raises(ConnectionError, match="no Ray cluster was found at '127"):
            RayWorkers(address)

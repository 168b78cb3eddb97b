"""Jobs done serially and by processes: the same results, whatever dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import deque
from typing import Any

import pytest

from swarm_envs.training.scale_out.episodes import receive, send
from swarm_envs.training.scale_out.jobs import (
    Job,
    LocalWorkers,
    Outcome,
    Serial,
    WorkerPool,
    answer,
)
from swarm_envs.training.scale_out.options import ScaleOptions
from tests.helpers.small_jobs import alive, wait_for

HERE = "tests.helpers.small_jobs"


def job(function: str, label: str = "", **arguments: Any) -> Job:
    return Job(f"{HERE}:{function}", arguments, label or function)


def done(workers: WorkerPool, *jobs: Job) -> dict[str, Outcome]:
    """Outcomes by label; each is there once."""
    outcomes = list(workers.run(deque(jobs)))
    found = {outcome.job.label: outcome for outcome in outcomes}
    assert len(found) == len(outcomes) == len(jobs)
    return found


@pytest.fixture(scope="module")
def pair():
    with LocalWorkers(2) as workers:
        yield workers


def squares() -> list[Job]:
    return [job("square", f"{k}", value=0.1 * k + 1e-9 / (k + 1)) for k in range(40)]


def test_processes_give_what_this_one_gives(pair):
    serial, local = done(Serial(), *squares()), done(pair, *squares())
    assert {k: o.result for k, o in serial.items()} == {k: o.result for k, o in local.items()}
    assert serial["7"].result["square"] == (0.1 * 7 + 1e-9 / 8) ** 2 / 3.0


@pytest.mark.parametrize("where", ["here", "there"])
def test_a_job_that_fails_is_told_and_stops_no_other(where, pair):
    jobs = [
        job("square", value=2.0),
        job("fails", value=3.0),
        job("leaves"),
        job("not_json"),
        Job("no.such:module", {}, "missing"),
        job("fails", "wrong arguments"),
    ]
    found = done(Serial() if where == "here" else pair, *jobs, job("square", "last", value=4.0))
    assert found["square"].error is found["last"].error is None
    assert found["fails"].error == "ValueError: nobody squares 3.0"
    assert "in fails" in found["fails"].trace
    assert found["leaves"].error == "SystemExit: bye"
    assert "not JSON compliant" in str(found["not_json"].error)
    assert "No module named 'no'" in str(found["missing"].error)
    assert "missing 1 required" in str(found["wrong arguments"].error)


@pytest.mark.parametrize(("times", "begun"), [(2, 3), (99, 4)])
def test_a_job_whose_process_dies_is_begun_anew_until_it_is_given_up(times, begun, tmp_path):
    with LocalWorkers(2) as workers:
        found = done(workers, job("dies", folder=str(tmp_path), times=times), *squares())
    died = found.pop("dies")
    assert len(list(tmp_path.iterdir())) == begun
    if times < begun:
        assert died.result == begun
    else:
        assert f"died, {begun} times: killed by SIGKILL" in str(died.error)
    assert not any(outcome.error for outcome in found.values())


def test_the_queue_may_be_changed_between_outcomes(pair):
    jobs = deque(squares()[:6])
    given = []
    for outcome in pair.run(jobs):
        given.append(outcome.job.label)
        if len(given) == 1:
            jobs.clear()
            jobs.append(job("square", "new", value=1.0))
    assert "new" in given
    assert len(given) <= 4  # two were under way


DRIVER = f"""
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
from collections import deque
from swarm_envs.training.scale_out.jobs import Job, LocalWorkers
given = {{"folder": sys.argv[1], "name": "a", "seconds": 600.0}}
with LocalWorkers(2) as workers:
    list(workers.run(deque([Job("{HERE}:slow", given), Job("{HERE}:slow", given)])))
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_processes_end_with_their_driver(how, tmp_path):
    driver = subprocess.Popen(
        [sys.executable, "-c", DRIVER, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stderr=subprocess.DEVNULL,
    )
    wait_for(lambda: len(list(tmp_path.iterdir())) == 2)
    driver.send_signal(how)
    driver.wait(120)
    wait_for(lambda: not any(alive(file) for file in tmp_path.iterdir()))


def test_another_version_is_refused():
    request = job("square", value=1.0).request()
    assert '"result"' in answer(request)
    assert "install the same version" in answer(request.replace('"version": "', '"version": "9'))


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"workers": 2, "ray": "auto"}, "--workers is 2"),
        ({"ray": "http://here:80"}, "must be 'auto', 'local', or host:port"),
    ],
)
def test_impossible_options_are_refused(options, why):
    with pytest.raises(ValueError, match=why):
        ScaleOptions(**options)


def test_without_ray_its_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"pip install 'swarm-envs\[ray\]'"):
        ScaleOptions(ray="local").open()


def test_a_file_is_used_where_it_stands_unless_it_is_another(tmp_path):
    file = tmp_path / "agent.py"
    file.write_text("one")
    sent = send(file)
    assert receive(sent) == file
    file.write_text("two")
    copy = receive(sent)
    assert copy != file
    assert copy.name == file.name
    file.unlink()
    assert receive(sent) == copy
    assert copy.read_text() == "one"

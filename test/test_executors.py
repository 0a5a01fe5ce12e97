# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Jobs on processes and on a Dask cluster: order, errors, deaths, Ctrl-C, threads."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from puma_sim_core.errors import ParameterError
from puma_sim_core.executors import Failure, Shard, open_executor, run_jobs, threads

ROOT = Path(__file__).resolve().parent.parent


def work(item):
    """What a job is told to do."""
    order, value = item
    if order == "wait":
        time.sleep(value)
    elif order == "refuse":
        raise ParameterError("bad", where=value, expected="good")
    elif order == "fail":
        return {}[value]
    elif order == "kill":
        os.kill(os.getpid(), value)
    elif order == "exit":
        sys.exit(value)
    elif order == "leave":
        os._exit(value)
    elif order == "unpicklable":
        return lambda: value
    elif order == "mask":
        return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    elif order == "environment":
        return {name: os.environ.get(name) for name in value}
    return value


ITEMS = [
    ("wait", 0.4),
    ("kill", int(signal.SIGKILL)),
    ("return", "a"),
    ("fail", "key"),
    ("refuse", "here"),
    ("leave", 3),
    ("exit", 4),
    ("unpicklable", 0),
    ("return", "b"),
]


def results(workers: int, items=ITEMS):
    seen = []
    with open_executor(workers) as executor:
        found = list(run_jobs(work, items, executor, lambda index, result: seen.append((index, result))))
    assert sorted(seen, key=lambda each: each[0]) == list(enumerate(found))
    return found, [index for index, _ in seen]


@pytest.fixture(scope="module")
def alone():
    return results(1)


def test_results_come_in_the_order_of_the_items_and_each_ending_says_why(alone):
    found, order = alone
    assert order == list(range(len(ITEMS)))
    assert [found[k] for k in (0, 2, 8)] == [0.4, "a", "b"]
    reasons = [found[k].reason for k in (1, 3, 4, 5, 6)]
    assert "SIGKILL" in reasons[0]
    assert reasons[1] == "KeyError: 'key'"
    assert reasons[2] == "here: bad; expected good"
    assert "status 3" in reasons[3]
    assert reasons[4] == "SystemExit: 4"
    assert "lambda" in found[7].reason
    assert [found[k].died for k in (1, 3, 4, 5, 6, 7)] == [True, False, False, True, False, False]
    # where an error is none of the package's, the trace says where it came from
    assert ["in work" in found[k].trace for k in (3, 4)] == [True, False]


@pytest.mark.parametrize("workers", [2, 12])
def test_the_number_of_processes_changes_the_order_of_the_work_and_nothing_else(alone, workers):
    found, order = results(workers)
    assert [(f.reason, f.died) if isinstance(f, Failure) else f for f in found] == [
        (f.reason, f.died) if isinstance(f, Failure) else f for f in alone[0]
    ]
    # the first one waits
    assert order != sorted(order)


def test_no_items_no_processes():
    assert results(3, [])[0] == []


def test_processes_share_the_cores(monkeypatch):
    names = ("PUMA_SIM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    monkeypatch.setenv(names[0], "6")
    before = dict(os.environ)
    (found,), _ = results(2, [("environment", names)])
    assert found == dict(zip(names, ("3", "1", "1", "1")))
    assert dict(os.environ) == before


def test_threads_come_from_the_environment(monkeypatch):
    monkeypatch.delenv("PUMA_SIM_THREADS", raising=False)
    assert 1 <= threads() <= os.cpu_count()
    for wrong in ("0", "-1", "two", "", "1.5"):
        monkeypatch.setenv("PUMA_SIM_THREADS", wrong)
        with pytest.raises(ParameterError, match="PUMA_SIM_THREADS"):
            threads()


def test_an_error_of_the_caller_ends_what_runs():
    begin = time.monotonic()
    with pytest.raises(ZeroDivisionError), open_executor(2) as executor:
        for _ in run_jobs(work, [("return", 0), *[("wait", 600.0)] * 4], executor):
            raise ZeroDivisionError
    assert time.monotonic() - begin < 300.0


SCRIPT = """
import sys
sys.path.insert(0, {test!r})
from puma_sim_core.executors import open_executor, run_jobs
from test_executors import work
if __name__ == "__main__":
    try:
        with open_executor(2) as executor:
            for result in run_jobs(work, [("return", "begun"), *[("wait", 600.0)] * 5], executor):
                print(result, flush=True)
    except KeyboardInterrupt:
        sys.exit(130)
"""


DEAF = """
import sys
sys.path.insert(0, {test!r})
from puma_sim_core.executors import open_executor, run_jobs
from test_executors import work
if __name__ == "__main__":
    with open_executor(2) as executor:
        # two at least that each process gets one
        print(*run_jobs(work, [("mask", None)] * 8, executor))
"""


def test_no_process_hears_ctrl_c_not_even_the_first_of_a_program(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(DEAF.format(test=str(ROOT / "test")))
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    found = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True, env=environment)
    assert found.stdout.split() == ["True"] * 8


def living(group: int) -> list[str]:
    """The state, parent and group of the processes of a group that have not ended."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(") ")[2].split()
        except OSError:
            continue
        if fields[0] != "Z" and fields[2] == str(group):
            found.append(f"{path.parent.name}: {fields[:3]}")
    return found


def test_ctrl_c_ends_the_processes_without_a_word(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(test=str(ROOT / "test")))
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=pipe,
        stderr=pipe,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout.readline() == "begun\n"
    # as a terminal does: all processes of the group
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60.0)
    assert (process.returncode, out, err) == (130, "", "")
    for _ in range(100):
        if not living(process.pid):
            break
        time.sleep(0.1)
    assert not living(process.pid)


# -- shards ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 7, 40])
def test_shards_have_each_item_once(count):
    items = list(range(23))
    shards = [Shard.parse(f"{index}/{count}").of(items) for index in range(1, count + 1)]
    assert sorted(item for shard in shards for item in shard) == items
    assert max(map(len, shards)) - min(map(len, shards)) <= 1
    assert Shard().of(items) == items


@pytest.mark.parametrize("text", ["", "1", "0/3", "4/3", "1/0", "-1/3", "a/b", "1/3/5", "1.0/3"])
def test_a_shard_that_there_is_not(text):
    with pytest.raises(ParameterError, match="--shard"):
        Shard.parse(text)


# -- a Dask cluster -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cluster():
    distributed = pytest.importorskip("dask.distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        yield cluster.scheduler_address


def test_a_dask_cluster_gives_what_processes_give(alone, cluster):
    names = ("PUMA_SIM_THREADS", "OPENBLAS_NUM_THREADS")
    # a death takes several workers of a cluster with it, since Dask tries again: tests of processes have it
    kept = [k for k, (order, _) in enumerate(ITEMS) if order not in ("kill", "leave", "exit", "unpicklable")]
    items = [*[ITEMS[k] for k in kept], ("environment", names)]
    with open_executor(scheduler=cluster) as executor:
        found = list(run_jobs(work, items, executor))
    reasons = [each.reason if isinstance(each, Failure) else each for each in found]
    expected = [alone[0][k].reason if isinstance(alone[0][k], Failure) else alone[0][k] for k in kept]
    assert reasons == [*expected, dict.fromkeys(names, "1")]


def test_a_scheduler_that_does_not_answer():
    pytest.importorskip("dask.distributed")
    for address in ("tcp://127.0.0.1:9", "no address at all", "tcp://127.0.0.1", "tcp://127.0.0.1:99999"):
        with pytest.raises(ParameterError, match="scheduler"), open_executor(scheduler=address):
            pass


def test_contradictions():
    for jobs, scheduler in ((0, None), (-3, None), (2, "tcp://127.0.0.1:9")):
        with pytest.raises(ParameterError), open_executor(jobs, scheduler):
            pass

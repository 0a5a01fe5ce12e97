# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One process compiles, however many programs begin; who waits for it goes on when it is done or has failed.

With a short program in the place of the compiler.
"""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from puma_sim_core import compiling, jit
from puma_sim_core.compiling import FAILED, STARTS, WAITS, Compilation
from puma_sim_core.identify import compile_ahead

#: makes the mark of each part that it is asked for
MAKES = "import sys, pathlib; [pathlib.Path(sys.argv[1], name).touch() for name in sys.argv[2:]]"


@pytest.fixture
def begun(tmp_path, monkeypatch):
    """Starts a `Compilation` by a program in place of the compiler; the words of each start and what was said."""
    real, started, said = subprocess.Popen, [], []

    def compilation(body: str, **options) -> Compilation:
        def start(words, **rest):
            started.append(words)
            parts = words[words.index("--locked") + 1 :]
            return real([sys.executable, "-c", body, str(tmp_path), *parts], **rest)

        monkeypatch.setattr(compiling.subprocess, "Popen", start)
        return Compilation(said.append, **options)

    monkeypatch.setenv("PUMA_SIM_KERNEL", "auto")
    monkeypatch.setattr(jit, "BACKEND", "numba")
    monkeypatch.setattr(jit, "compiled_mark", lambda part: tmp_path / part)
    monkeypatch.setattr(jit, "await_compiled", lambda *_: None)
    compilation.started, compilation.said = started, said
    return compilation


@pytest.mark.parametrize("patient", [False, True])
def test_programs_that_begin_together_start_one_process(begun, patient):
    slow = f"import time; time.sleep(0.5); {MAKES}"
    first, *others = [begun(slow, patient=patient) for _ in range(5)]
    assert len(begun.started) == 1
    assert set(begun.said) == (set() if patient else {STARTS})
    for each in (*others, first) if patient else (first, *others):
        each.wait()
    assert len(begun.started) == 1
    begun(slow).wait()  # all is there now
    assert len(begun.started) == 1


@pytest.mark.parametrize(("patient", "niceness"), [(False, 10), (True, 0)])
def test_the_process_stands_behind_work_that_goes_on(begun, patient, niceness):
    process = begun(f"import time; time.sleep(0.5); {MAKES}", patient=patient)._process
    assert os.getpriority(os.PRIO_PROCESS, process.pid) == (niceness or os.getpriority(os.PRIO_PROCESS, 0))
    group = Path(f"/proc/{process.pid}/autogroup")
    assert not group.exists() or f"nice {niceness}" in group.read_text()
    process.wait()


def _looks(compilation: Compilation, done: threading.Event) -> None:
    while not done.is_set():
        compilation._awaited("arm")


def test_a_process_behind_others_gives_way_to_one_that_is_waited_for(begun, tmp_path):
    """It would take as long as the others work."""
    first, *others = [begun("import time; time.sleep(600)") for _ in range(6)]
    waits = begun(f"import time; time.sleep(0.3); {MAKES}", patient=True)
    assert len(begun.started) == 1
    # programs that go on find now and then what is missing, and none of them takes the place of the one that waits
    done = threading.Event()
    at_work = [threading.Thread(target=_looks, args=(each, done)) for each in (first, *others)]
    for each in at_work:
        each.start()
    process = first._process
    waits.wait()
    done.set()
    for each in at_work:
        each.join()
    assert process.wait() == -signal.SIGTERM
    assert len(begun.started) == 2 and all((tmp_path / part).exists() for part in jit.PARTS)
    assert FAILED.format(tmp_path / "log") not in begun.said


def test_compiling_ahead_does_not_wait_for_a_process_behind_others(begun, tmp_path, monkeypatch):
    """`make test` waited for what `make run` had left."""
    first = begun("import time; time.sleep(600)")
    parts = {name: lambda: None for name in jit.PARTS}
    monkeypatch.setattr(compile_ahead, "_PARTS", parts)
    monkeypatch.setattr("sys.argv", ["compile_ahead"])
    assert compile_ahead.main() == 0
    assert first._process.wait() == -signal.SIGTERM
    assert all((tmp_path / part).exists() for part in jit.PARTS)


@pytest.mark.skipif(jit.compiled_mark("arm") is None, reason="nothing is kept: no numba, or no folder for it")
def test_the_first_explanation_compiles_nothing():
    """What `explain` runs of what is kept on the disk is kept by then: the first one waited four seconds for it."""
    program = """
import pkgutil, importlib, numba
import puma_sim_core
from puma_sim_core.identify import compile_ahead, explain
for part in compile_ahead._PARTS.values():
    part()
for info in pkgutil.walk_packages(puma_sim_core.__path__, "puma_sim_core."):
    if info.name.startswith(("puma_sim_core.identify", "puma_sim_core.effects", "puma_sim_core.dynamics.runs")):
        for name, value in vars(importlib.import_module(info.name)).items():
            kept = isinstance(value, numba.core.dispatcher.Dispatcher) and hasattr(value._cache, "_cache_path")
            if kept and value.__module__ == info.name:
                print(info.name, name, len(value.signatures))
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    found = {name: int(count) for *_, name, count in map(str.split, ran.stdout.splitlines())}
    assert {"play", "recursion", "_knock", "_terminal_voltages"} <= found.keys()
    # two are loaded by what calls them, which is compiled itself
    assert {name for name, count in found.items() if count == 0} <= {"_sliding", "_bent"}


def test_a_process_that_fails_is_told_once_and_not_tried_again(begun, tmp_path):
    patient = begun("raise SystemExit(1)", patient=True, parts=("arm",))
    patient.wait()
    patient.wait()
    assert begun.said == [WAITS, FAILED.format(tmp_path / "log")]
    assert len(begun.started) == 1


def test_what_another_program_has_not_made_is_made_when_that_has_ended(begun, tmp_path):
    with open(tmp_path / "lock", "a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        waits = begun(MAKES, patient=True, parts=("arm", "trials"))
        assert begun.started == []
        # the other one ends with a part of it
        (tmp_path / "arm").touch()
        timer = threading.Timer(0.3, fcntl.flock, (lock, fcntl.LOCK_UN))
        timer.start()
        waits.wait()
        timer.join()
    assert len(begun.started) == 1 and (tmp_path / "trials").exists()
    assert begun.said == [WAITS]


@pytest.mark.skipif(jit.BACKEND != "numba", reason="there is one kernel alone")
def test_threads_that_see_together_that_a_part_is_there_all_go_on():
    """Seen on a cold cache: of two threads that ran a model as the compiler ended, one stopped with a KeyError."""
    together, answers = threading.Barrier(4), []

    def awaited() -> bool:
        together.wait(timeout=30.0)
        return False

    jit.await_compiled("trains", awaited)
    threads = [threading.Thread(target=lambda: answers.append(jit.is_compiled("trains"))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [True] * 4


def test_threads_that_wait_together_say_it_once_and_go_on(begun, monkeypatch):
    asked = {}
    monkeypatch.setattr(jit, "await_compiled", asked.__setitem__)
    begun(f"import time; time.sleep(0.5); {MAKES}", patient=True)
    answers = []
    threads = [threading.Thread(target=lambda: answers.append(asked["identification"]())) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [False] * 4 and begun.said == [WAITS] and len(begun.started) == 1

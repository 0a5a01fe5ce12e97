# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Independent jobs on processes of this machine, on a Dask cluster, or in shards of a batch queue.

Results come in the order of the items, and do not depend on where, or in what order, the jobs were done::

    with open_executor(jobs=4) as executor:
        for item, result in zip(items, run_jobs(function, items, executor)):
            ...
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import re
import signal
import socket
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, TypeVar

from puma_sim_core.errors import ParameterError, PumaSimError

try:
    from threadpoolctl import threadpool_limits
except ImportError:  # no package of Ubuntu's that rosdep knows: there it is slower, and no more
    threadpool_limits = None

Item = TypeVar("Item")
Result = TypeVar("Result")

#: threads that one process may use for runs of the model; all cores by default
THREADS = "PUMA_SIM_THREADS"
#: threads of the libraries of linear algebra: a job has one, so that its sums do not depend on the number of workers
_LIBRARIES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
#: seconds between two calls of `on_wait`, and that a scheduler has to answer
_LOOK, _PATIENCE = 0.5, 10.0
_ADDRESS = re.compile(r"(tcp|tls)://(?P<host>[^/:]+|\[[0-9a-fA-F:]+\]):(?P<port>\d{1,5})")


class WorkerDied(RuntimeError):
    """The process of a job ended before the job did."""


@dataclass(frozen=True)
class Failure:
    """Why a job has no result: the reason, one line; the trace of an error that is no `PumaSimError`; died: the process
    ended, so that the job may succeed elsewhere."""

    reason: str
    trace: str = ""
    died: bool = False


class Shard(NamedTuple):
    """The items of one of several runs of the same command: part, from 1 on, of parts."""

    part: int = 1
    parts: int = 1

    @classmethod
    def parse(cls, text: str) -> Shard:
        """The shard of a text "2/8".

        Raises ParameterError: another form, or no such shard.
        """
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text.strip())
        shard = cls(*map(int, found.groups())) if found else cls(0, 0)
        if not 1 <= shard.part <= shard.parts:
            raise ParameterError(f"'{text}'", where="--shard", expected="i/n with i from 1 to n, such as 2/8")
        return shard

    def of(self, items: Sequence[Item]) -> list[Item]:
        """Every parts-th item, beginning with number `part`: all shards together have each item once."""
        return list(items[self.part - 1 :: self.parts])


def usable_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads() -> int:
    """Threads that this process may use for runs of the model.

    Raises ParameterError: the environment variable PUMA_SIM_THREADS is no number from 1 on.
    """
    text = os.environ.get(THREADS)
    if text is None:
        return usable_cores()
    if not re.fullmatch(r"[1-9]\d{0,4}", text):
        raise ParameterError(f"'{text}'", where=f"environment variable {THREADS}", expected="a number from 1 on")
    return int(text)


def run_jobs(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    executor: Executor,
    on_result: Callable[[int, Result | Failure], None] | None = None,
    on_wait: Callable[[], None] | None = None,
) -> Iterator[Result | Failure]:
    """Yield the result of each item, in the order of the items; a `Failure` where the job ended with an error.

    Parameters
    ----------
    function : a function of a module, of one argument; it and the items go to other processes by pickle.
    executor : of `open_executor`.
    on_result : called with (index, result) as soon as a result is there, in any order.
    on_wait : called about twice a second while jobs run.

    An error of the caller or of a callback, Ctrl-C among them, cancels the jobs that have not begun.
    """
    ended: SimpleQueue[int] = SimpleQueue()
    futures: list[Future[Result | Failure]] = []
    try:
        for index, item in enumerate(items):
            futures.append(executor.submit(_attempt, function, item))
            futures[-1].add_done_callback(lambda _, index=index: ended.put(index))  # type: ignore[misc]
        results: dict[int, Result | Failure] = {}
        for index in range(len(futures)):
            while index not in results:
                try:
                    done = ended.get(timeout=_LOOK)
                except Empty:
                    pass
                else:
                    results[done] = _result(futures[done])
                    if on_result is not None:
                        on_result(done, results[done])
                if on_wait is not None:
                    on_wait()
            yield results.pop(index)
    finally:
        for future in futures:
            future.cancel()


def _attempt(function: Callable[[Item], Result], item: Item) -> Result | Failure:
    """The function of an item, or why there is no result; in the process of the job."""
    _limit_threads()
    try:
        return function(item)
    except PumaSimError as error:
        return Failure(" ".join(str(error).split()))
    except BaseException as error:
        return Failure(_line(error), traceback.format_exc())


def _result(future: Future[Result | Failure]) -> Result | Failure:
    try:
        return future.result()
    except Exception as error:
        # Dask names the address of a worker, which differs from run to run
        died = isinstance(error, WorkerDied) or type(error).__name__ == "KilledWorker"
        reason = str(error) if isinstance(error, WorkerDied) else "the worker process died" if died else _line(error)
        return Failure(reason, died=died)


def _line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")


def _limit_threads() -> None:
    """One thread for linear algebra and, where nobody has said how many, one for runs of the model."""
    os.environ.setdefault(THREADS, "1")
    if threadpool_limits is not None and any(os.environ.get(name) != "1" for name in _LIBRARIES[:3]):
        threadpool_limits(1)


@contextmanager
def one_thread_of_algebra() -> Iterator[None]:
    """One thread for linear algebra, in this process, until the end of the block.

    The matrices of an explanation are small: on several threads the libraries spend more time waiting for each other
    than they save, and their sums depend on how many there are. Runs of the model are shared among `threads`.
    """
    with nullcontext() if threadpool_limits is None else threadpool_limits(1, user_api="blas"):
        yield


# -- where jobs run -------------------------------------------------------------------------------


@contextmanager
def open_executor(jobs: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """Processes of this machine, or the workers of a Dask cluster; jobs that run when an error comes are given up.

    Parameters
    ----------
    jobs : processes at a time; None: one for each core.
    scheduler : address of a Dask scheduler, such as tcp://host:8786, in place of processes.

    Raises
    ------
    ParameterError : jobs below 1, both given, no such scheduler, or Dask is not installed.
    """
    if jobs is not None and scheduler is not None:
        raise ParameterError("jobs and a scheduler", expected="processes of this machine, or a Dask cluster")
    if jobs is not None and jobs < 1:
        raise ParameterError(f"{jobs} jobs", expected="1 or more")
    with _processes(jobs or usable_cores()) if scheduler is None else _cluster(scheduler) as executor:
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    executor = Processes(count)
    try:
        yield executor
    finally:
        executor.end()


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    try:
        from dask.distributed import Client  # noqa: PLC0415  (of the extra `cluster`)
    except ImportError:
        expected = "pip install 'puma_sim_ros[cluster]', or --jobs"
        raise ParameterError("Dask is not installed", where=f"scheduler {address}", expected=expected) from None
    expected = "the address of a running Dask scheduler, such as tcp://host:8786"
    found = _ADDRESS.fullmatch(address)
    if found is None or int(found["port"]) > 65535:
        raise ParameterError("no address", where=f"scheduler {address}", expected=expected)
    try:
        # a client that never reached a scheduler does not always end well
        socket.create_connection((found["host"].strip("[]"), int(found["port"])), _PATIENCE).close()
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except OSError as error:
        raise ParameterError(f"no answer ({_line(error)})", where=f"scheduler {address}", expected=expected) from None
    with client:
        yield client.get_executor()


class Processes(Executor):
    """Processes that do one job at a time each. One that ends in a job fails that job alone, by `WorkerDied`.

    The processes are fresh interpreters, for threads of compiled code do not survive a fork.
    """

    def __init__(self, count: int):
        self._pool = ThreadPoolExecutor(count, thread_name_prefix="puma-sim-jobs")
        self._threads = max(1, threads() // count)
        self._own = threading.local()
        self._workers: list[_Worker] = []
        self._lock = threading.Lock()
        self._ended = False

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As `concurrent.futures.Executor.submit`."""
        return self._pool.submit(self._do, partial(function, *args, **kwargs))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: with `wait` when the jobs are done, else at once."""
        if not wait:
            self.end()
        self._pool.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            self.end()

    def end(self) -> None:
        """Terminate the processes, whatever they do."""
        with self._lock:
            self._ended = True
            for worker in self._workers:
                worker.process.terminate()
        self._pool.shutdown(cancel_futures=True)

    def _do(self, call: Callable[[], Any]) -> Any:
        """The result of a call in the process of this thread."""
        worker = getattr(self._own, "worker", None)
        if worker is None:
            with self._lock:
                if self._ended:
                    raise WorkerDied("the executor was shut down")
                worker = self._own.worker = _Worker(self._threads)
                self._workers.append(worker)
        try:
            return worker.do(call)
        except WorkerDied:
            with self._lock:
                self._workers.remove(worker)
            self._own.worker = None
            raise


class _Worker:
    """A process that waits for calls."""

    def __init__(self, threads: int):
        context = multiprocessing.get_context("spawn")
        self._near, far = context.Pipe()
        self.process = context.Process(target=_serve, args=(far,), daemon=True)
        with _inherited({THREADS: str(threads), **dict.fromkeys(_LIBRARIES, "1")}):
            self.process.start()
        far.close()

    def do(self, call: Callable[[], Any]) -> Any:
        """The result or the error of a call; raises WorkerDied where the process ends."""
        content = pickle.dumps(call)
        try:
            self._near.send_bytes(content)
            succeeded, value = pickle.loads(self._near.recv_bytes())
        except (EOFError, OSError):
            self.process.join()
            self._near.close()
            raise WorkerDied(_end(self.process.exitcode or 0)) from None
        if succeeded:
            return value
        raise value


def _end(code: int) -> str:
    """What an exit code of a process says."""
    if code >= 0:
        return f"the worker process ended with status {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = str(-code)
    memory = "; it may have run out of memory" if name == "SIGKILL" else ""
    return f"the worker process was ended by signal {name}{memory}"


@contextmanager
def _inherited(variables: dict[str, str]) -> Iterator[None]:
    """Variables, and deafness to Ctrl-C, for a process that is started in the block, one at a time."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    # its first start leaves the signal unblocked
    resource_tracker.ensure_running()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _serve(connection: Connection) -> None:
    """Do calls until the other end is closed."""
    while True:
        try:
            content = connection.recv_bytes()
        except EOFError:
            return
        try:
            answer = pickle.dumps((True, pickle.loads(content)()))
        except BaseException as error:
            answer = _refusal(error)
        connection.send_bytes(answer)


def _refusal(error: BaseException) -> bytes:
    """An error as it can be sent: some cannot be made again from what they were pickled to."""
    try:
        answer = pickle.dumps((False, error))
        pickle.loads(answer)
        return answer
    except Exception:
        return pickle.dumps((False, RuntimeError(_line(error))))

"""Executor over processes of this machine: each task alone in one, with limits on its time and memory.

Why not `pebble.ProcessPool`: its workers share one channel, which a worker holds locked while it unpickles a task, and
here that includes seconds of imports. If a worker is killed in that time (out of memory), the lock is never released:
with two workers and five tasks, pebble 5.2 lost all five after 122 s. A pebble pool for each process would avoid
that, but replaces only the lines of `_OneProcess`.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from typing import ParamSpec, TypeVar

from modalcam.plugins import load_plugins

P = ParamSpec("P")
T = TypeVar("T")

# One thread per process: results must not depend on how many processes share the machine.
SINGLE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Limits:
    """Limits of one task.

    Attributes
    ----------
    seconds : float
        From its start until it is stopped.
    memory_bytes : int or None
        Of its process; None is the machine's memory. Enforced on Linux only (RLIMIT_DATA).
    """

    # longer than any intact recording takes; it stops tasks that hang
    seconds: float = 3600.0
    memory_bytes: int | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.seconds < float("inf"):
            msg = f"a time limit must be positive and finite, got {self.seconds} s"
            raise ValueError(msg)
        if self.memory_bytes is not None and self.memory_bytes < 1:
            msg = f"a memory limit must be positive, got {self.memory_bytes} bytes"
            raise ValueError(msg)


class TimeLimitError(Exception):
    """A task was stopped because it exceeded its time limit."""


@contextmanager
def single_threaded_environment() -> Iterator[None]:
    """Environment in which new processes use one thread for linear algebra."""
    before = {name: os.environ.get(name) for name in SINGLE_THREAD}
    os.environ.update(dict.fromkeys(SINGLE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


class LocalExecutor(Executor):
    """Executor over `jobs` processes, each a pool of its own: the death of one affects no other task.

    A future raises BrokenExecutor if its process died and TimeLimitError if it was stopped. Processes start when they
    are first needed, in the environment of that moment, and run one task after the other.

    Parameters
    ----------
    jobs : int
    limits : Limits
    plugins : tuple of str
        Modules that each process loads before its first task, beside installed plugins.
    """

    def __init__(self, jobs: int, limits: Limits, plugins: tuple[str, ...] = ()) -> None:
        self._limits = limits
        self._plugins = plugins
        # Each thread owns one process and waits for its results. Processes inherit the blocked signals.
        self._threads = ThreadPoolExecutor(
            jobs, thread_name_prefix="modalcam-worker", initializer=_block_interrupts
        )
        self._own = threading.local()
        self._processes: list[_OneProcess] = []

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Schedule a call."""
        return self._threads.submit(self._run, fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:  # noqa: FBT001, FBT002
        """End the processes after the tasks that have begun and, unless cancelled, those that wait."""
        self._threads.shutdown(wait=wait, cancel_futures=cancel_futures)
        if wait:
            for process in self._processes:
                process.close()

    def kill(self) -> None:
        """Kill all processes at once; their tasks raise BrokenExecutor."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in self._processes:
            process.kill()

    def _run(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
        if not hasattr(self._own, "process"):
            self._own.process = _OneProcess(self._limits, self._plugins)
            self._processes.append(self._own.process)
        process: _OneProcess = self._own.process
        return process.run(fn, *args, **kwargs)


class _OneProcess:
    """One process at a time, started anew after it died."""

    def __init__(self, limits: Limits, plugins: tuple[str, ...]) -> None:
        self._limits = limits
        self._plugins = plugins
        self._pool: ProcessPoolExecutor | None = None
        self._pid = 0
        self._killed = False

    def run(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            pool = self._pool or self._start(fn)
            if self._killed:
                self.kill()
            future = pool.submit(fn, *args, **kwargs)
            return future.result(self._limits.seconds)
        except BrokenExecutor:
            self.close()
            raise
        except TimeoutError as error:
            if future.done():
                raise  # the task's own
            self.kill()
            self.close()
            self._killed = False
            msg = f"stopped after {self._limits.seconds:g} s"
            raise TimeLimitError(msg) from error

    def kill(self) -> None:
        self._killed = True
        if self._pid:
            # It is still our child and not yet waited for, so the number cannot be another process's.
            os.kill(self._pid, getattr(signal, "SIGKILL", signal.SIGTERM))

    def close(self) -> None:
        self._pid = 0
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def _start(self, fn: Callable[..., object]) -> ProcessPoolExecutor:
        # "spawn": OpenCV and PyAV hold threads, which a fork would copy in an unusable state.
        pool = ProcessPoolExecutor(
            1,
            mp_context=get_context("spawn"),
            initializer=_prepare,
            initargs=(self._limits.memory_bytes, self._plugins),
        )
        self._pool = pool
        # With the function as its argument this call imports what the task needs, outside the task's time limit.
        self._pid = pool.submit(_pid_with, fn).result()
        return pool


def _pid_with(_: Callable[..., object]) -> int:
    return os.getpid()


def _block_interrupts() -> None:
    """Keep Ctrl-C from processes that this thread starts, from their first instruction on."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _prepare(memory_bytes: int | None, plugins: tuple[str, ...]) -> None:
    # An interrupt is the parent's to handle: what has begun is finished and saved.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import cv2  # noqa: PLC0415 - only the worker needs it

    # OpenCV ignores the environment.
    cv2.setNumThreads(1)
    load_plugins(plugins)
    _limit_memory(memory_bytes)


def _end_with_parent() -> None:
    """End this process when its parent was killed: no task would ever come."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _limit_memory(memory_bytes: int | None) -> None:
    """Make an allocation beyond the limit fail in this process, before the system picks a process to kill."""
    if sys.platform != "linux":
        return
    import resource  # noqa: PLC0415 - not on every system

    if memory_bytes is None:
        memory_bytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    # Data, not the address space: that of a process with compiled code is many times what it uses.
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard != resource.RLIM_INFINITY:
        memory_bytes = min(memory_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, hard))

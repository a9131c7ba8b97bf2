"""Processes of this machine as an executor: each task alone in one, with limits on its time and memory."""

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

P = ParamSpec("P")
T = TypeVar("T")

# One thread a process: results must not depend on how many processes share the machine.
SINGLE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Limits:
    """What one task may take.

    Attributes
    ----------
    seconds : float
        From its start until it is stopped.
    memory_bytes : int or None
        Of its process; None is the machine's memory. Held where the system can (Linux: RLIMIT_DATA), not elsewhere.
    """

    # longer than any sound recording takes, so that one that hangs is stopped at all
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
    """A task was stopped because it took longer than it may."""


@contextmanager
def single_threaded_environment() -> Iterator[None]:
    """Environment in which processes start with one thread for linear algebra."""
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
    """Executor over `jobs` processes, each a pool of its own: who dies or is stopped takes no other task along.

    A future raises BrokenExecutor when its process died, TimeLimitError when it was stopped. Processes start as they
    are needed, in the environment of that moment, and serve one task after the other.
    """

    def __init__(self, jobs: int, limits: Limits) -> None:
        self._limits = limits
        # Each thread keeps one process and waits for what it does.
        self._threads = ThreadPoolExecutor(jobs, thread_name_prefix="modalcam-worker")
        self._own = threading.local()
        self._processes: list[_OneProcess] = []

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Schedule a call."""
        return self._threads.submit(self._run, fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:  # noqa: FBT001, FBT002
        """End the processes, after what has begun and, unless cancelled, what waits."""
        self._threads.shutdown(wait=wait, cancel_futures=cancel_futures)
        if wait:
            for process in self._processes:
                process.close()

    def _run(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
        if not hasattr(self._own, "process"):
            self._own.process = _OneProcess(self._limits)
            self._processes.append(self._own.process)
        process: _OneProcess = self._own.process
        return process.run(fn, *args, **kwargs)


class _OneProcess:
    """One process at a time, started anew after it died."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._pool: ProcessPoolExecutor | None = None
        self._pid = 0

    def run(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            pool = self._pool or self._start(fn)
            future = pool.submit(fn, *args, **kwargs)
            return future.result(self._limits.seconds)
        except BrokenExecutor:
            self.close()
            raise
        except TimeoutError as error:
            if future.done():
                raise  # the task's own
            self._kill()
            msg = f"stopped after {self._limits.seconds:g} s"
            raise TimeLimitError(msg) from error

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def _start(self, fn: Callable[..., object]) -> ProcessPoolExecutor:
        # "spawn": OpenCV and PyAV hold threads, which a fork would copy in an unusable state.
        pool = ProcessPoolExecutor(
            1, mp_context=get_context("spawn"), initializer=_prepare, initargs=(self._limits.memory_bytes,)
        )
        self._pool = pool
        # Taking the function as well, it imports what that needs: no task's time.
        self._pid = pool.submit(_pid_with, fn).result()
        return pool

    def _kill(self) -> None:
        # It is still our child and not yet waited for, so that the number cannot be another's.
        os.kill(self._pid, getattr(signal, "SIGKILL", signal.SIGTERM))
        self.close()


def _pid_with(_: Callable[..., object]) -> int:
    return os.getpid()


def _prepare(memory_bytes: int | None) -> None:
    import cv2  # noqa: PLC0415 - only the worker needs it

    # It does not heed the environment.
    cv2.setNumThreads(1)
    # An interrupt is the parent's to handle: what has begun is finished and saved.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _limit_memory(memory_bytes)


def _end_with_parent() -> None:
    """Not to be left behind by a parent that was killed: no task would ever come."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _limit_memory(memory_bytes: int | None) -> None:
    """Let what asks for more memory fail by itself, before the system picks a process to kill."""
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

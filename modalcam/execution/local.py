"""Tasks in processes of this machine: one task at a time in each, with limits on time and memory.

Why not `pebble.ProcessPool`: its workers share one channel, which a worker holds locked while it unpickles a task, and
here that includes seconds of imports. If a worker is killed in that time (out of memory), the lock is never released:
with two workers and five tasks, pebble 5.2 lost all five after 122 s. A pebble pool for each process would avoid
that, but replaces only the lines of `_OneProcess`.
"""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from typing import TypeVar

from modalcam.execution.heap import peak_bytes, return_large_arrays
from modalcam.files import silence_readers
from modalcam.plugins import load_plugins

Task = TypeVar("Task")
Result = TypeVar("Result")

# One thread per process: results must not depend on how many processes share the machine.
SINGLE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
# Peak of a process above which the next tasks get a new one: after a film of a million frames, a tenth of a gigabyte is
# libraries of the tracker and what remains in the heap, beside which the identification of its record would run. Short
# recordings stay below it, since a new process takes seconds.
_LARGE_BYTES = 400 * 2**20


@dataclass(frozen=True)
class Limits:
    """Limits of one task: from its start until it is stopped, and on the memory of its process.

    The memory is limited on Linux only (RLIMIT_DATA), without `memory_bytes` to that of the machine.
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


class LocalExecutor:
    """Executor over `jobs` separate processes: the death of one affects no other task.

    A future raises BrokenExecutor if its process died and TimeLimitError if it was stopped. Processes start when they
    are first needed, in the environment of that moment, load the plugins, and run one task after the other.
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

    def submit(self, function: Callable[[Task], Result], task: Task) -> Future[Result]:
        """Schedule a call."""
        return self._threads.submit(self._run, function, task)

    def close(self, *, drop: bool = False) -> None:
        """End the processes after the running tasks and, unless they are dropped, the waiting ones."""
        self._threads.shutdown(wait=True, cancel_futures=drop)
        for process in self._processes:
            process.close()

    def renew(self) -> None:
        """End the processes that needed much memory, while no task runs: the next ones need not what these hold."""
        for process in self._processes:
            process.renew()

    def kill(self) -> None:
        """Kill all processes at once; their tasks raise BrokenExecutor."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in self._processes:
            process.kill()

    def _run(self, function: Callable[[Task], Result], task: Task) -> Result:
        if not hasattr(self._own, "process"):
            self._own.process = _OneProcess(self._limits, self._plugins)
            self._processes.append(self._own.process)
        result: Result = self._own.process.run(function, task)
        return result


class _OneProcess:
    """One process at a time, started anew after it died."""

    def __init__(self, limits: Limits, plugins: tuple[str, ...]) -> None:
        self._limits = limits
        self._plugins = plugins
        self._pool: ProcessPoolExecutor | None = None
        self._pid = 0
        self._killed = False

    def run(self, function: Callable[[Task], Result], task: Task) -> Result:
        try:
            pool = self._pool or self._start(function)
            if self._killed:
                self.kill()
            future = pool.submit(function, task)
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

    def renew(self) -> None:
        if self._pid and peak_bytes(self._pid) > _LARGE_BYTES:
            self.close()

    def close(self) -> None:
        self._pid = 0
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def _start(self, function: Callable[..., object]) -> ProcessPoolExecutor:
        # "spawn": OpenCV and PyAV hold threads, which a fork would copy in an unusable state.
        pool = ProcessPoolExecutor(
            1,
            mp_context=get_context("spawn"),
            initializer=_prepare,
            initargs=(self._limits.memory_bytes, self._plugins),
        )
        self._pool = pool
        # With the function as its argument this call imports what the task needs, outside the task's time limit.
        self._pid = pool.submit(_pid_with, function).result()
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
    # As in `modalcam.__main__`: its end shall not take half a second, for which the command would wait.
    atexit.register(gc.freeze)
    silence_readers()
    return_large_arrays()
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

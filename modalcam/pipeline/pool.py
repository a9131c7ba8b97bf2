"""Tasks in other processes, local or on a cluster: failures are values, an interrupt lets running tasks finish.

Tasks in processes of this machine: one task at a time in each, with limits on time and memory.

Why not `pebble.ProcessPool`: its workers share one channel, which a worker holds locked while it unpickles a task, and
here that includes seconds of imports. If a worker is killed in that time (out of memory), the lock is never released:
with two workers and five tasks, pebble 5.2 lost all five after 122 s. A pebble pool for each process would avoid
that, but replaces only the lines of `_OneProcess`. Why not loky: a worker that dies fails every task that has not
ended (3.7: four of six), and a task has no time limit. Neither limits memory.
"""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any, TypeVar

from modalcam.common import ModalcamError, silence_readers
from modalcam.plugins import load_plugins
from tracker import Failure, checked

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


@dataclass(frozen=True)
class Tuning:
    """Memory of processes."""

    #: [bytes] an array of this size is returned to the system when it is freed
    #: measurement: A column of half a million samples; smaller arrays are reused faster than the system gives new
    #: pages.
    large_array: int = 4 * 2**20
    #: [bytes] a smaller limit on data (RLIMIT_DATA) is refused
    #: measurement: NumPy, SciPy, OpenCV, FFmpeg and numba take 268 MB (x86-64, one thread); a fifth for a recording.
    least_data: int = 320 * 2**20
    #: [bytes] a smaller limit on addresses (RLIMIT_AS) is refused
    #: measurement: The same libraries take 832 MB of addresses.
    least_address: int = 1000 * 2**20
    #: [bytes] a process whose memory was larger at its peak is replaced before the next stage
    #: measurement: Above: the libraries and the heap of a film of a million frames hold 0.1 GB; short recordings stay
    #: below.
    large: int = 400 * 2**20


TUNING = Tuning()


@dataclass(frozen=True)
class Limits:
    """Limits of one task: from its start until it is stopped, and on the memory of its process.

    The memory is limited on Linux only (RLIMIT_DATA), without `memory_bytes` to that of the machine.
    """

    # longer than any intact recording takes; it stops tasks that hang
    seconds: float = 3600.0
    memory_bytes: int | None = None

    def __post_init__(self) -> None:
        checked("the time limit in s", self.seconds, positive=True)
        if self.memory_bytes is not None:
            checked("the memory limit in bytes", self.memory_bytes, at_least=1)


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
        if self._pid and peak_bytes(self._pid) > TUNING.large:
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


Announce = Callable[[str], object]

# longest time until an interrupt is noticed
_TICK_S = 0.1
_DIED = "the process that worked on it died, twice; the file may be damaged or too large for memory"


@dataclass(frozen=True)
class TaskFailure(Failure):
    """A task without a result; `internal` if it raised an unexpected exception."""

    internal: bool = False


@contextmanager
def worker_pool(
    jobs: int,
    limits: Limits | None = None,
    *,
    plugins: tuple[str, ...] = (),
    announce: Announce | None = None,
) -> Iterator[WorkerPool]:
    """Pool of `jobs` processes of this machine, started when needed; on leaving, tasks not begun are dropped."""
    checked("the number of worker processes", jobs, at_least=1)
    limits = limits or Limits()
    before = {name: os.environ[name] for name in SINGLE_THREAD if name in os.environ}
    os.environ.update(dict.fromkeys(SINGLE_THREAD, "1"))
    executor = LocalExecutor(jobs, limits, plugins)
    try:
        yield WorkerPool(
            executor.submit,
            limits,
            kill=executor.kill,
            renew=executor.renew,
            announce=announce,
            on_this_machine=True,
        )
    finally:
        executor.close(drop=True)
        for name in SINGLE_THREAD:
            del os.environ[name]
        os.environ.update(before)


class WorkerPool:
    """Runs a function over tasks in other processes; results come in the order of the tasks.

    `failures` counts the tasks so far that gave no result, `internal_errors` those of them that raised an unexpected
    exception.

    Parameters
    ----------
    submit : callable
        Of function and task; its futures raise TimeLimitError for a task that exceeded its time limit.
    limits : Limits
        Those that hold for the tasks, for the texts of failures.
    died : tuple of exception types
        What its futures raise for a task whose process died.
    kill : callable
        Ends all tasks at once, for the second interrupt.
    renew : callable
        Ends processes that hold memory which further tasks do not need; called before them.
    on_this_machine : bool
        Whether all tasks run here, with what numba has compiled for this machine.
    announce : callable, optional
        Shows the response to an interrupt; by default it is written to standard error.
    """

    def __init__(
        self,
        submit: Callable[..., Future[Any]],
        limits: Limits,
        *,
        died: tuple[type[BaseException], ...] = (BrokenExecutor,),
        kill: Callable[[], object] = lambda: None,
        renew: Callable[[], object] = lambda: None,
        announce: Announce | None = None,
        on_this_machine: bool = False,
    ) -> None:
        self.on_this_machine = on_this_machine
        self.failures = 0
        self.internal_errors = 0
        self._submit = submit
        self._limits = limits
        self._died = died
        self._kill = kill
        self._renew = renew
        self._announce = announce or (lambda text: sys.stderr.write(f"{text}\n"))

    def map(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        done: Callable[[int], None] | None = None,
        *,
        look: Callable[[], None] = lambda: None,
        meanwhile: Iterator[object] | None = None,
        unit: str = "recording",
    ) -> list[Result | TaskFailure]:
        """Result of each task, or `TaskFailure`; `done` is called with the index of each task as it ends.

        `look` is called several times a second until then. `meanwhile` is work of this process: a step of it is taken
        whenever no task has ended, until there is none left or all tasks have ended.

        A task whose process died is tried once more, after all others and alone: memory may have been short. A
        ModalcamError of a task is raised: it concerns more than that task. After an interrupt (SIGINT, or SIGTERM where
        that raises KeyboardInterrupt) tasks that have begun end first and others are dropped; a second interrupt kills
        those that have begun. `unit` names a task in the response to an interrupt.
        """
        results: dict[int, Result | TaskFailure] = {}
        self._renew()

        def take(index: int, result: Result | TaskFailure) -> None:
            results[index] = result
            if done is not None:
                done(index)

        with _collected_interrupts() as interrupts:
            steps = iter(()) if meanwhile is None else meanwhile
            collect = partial(
                self._collect, take=take, look=look, meanwhile=steps, interrupts=interrupts, unit=unit
            )
            todo = {self._submit(function, task): index for index, task in enumerate(tasks)}
            for index in sorted(collect(todo)):
                if collect({self._submit(function, tasks[index]): index}):
                    take(index, TaskFailure(_DIED))
        failed = [result for result in results.values() if isinstance(result, TaskFailure)]
        self.failures += len(failed)
        self.internal_errors += sum(failure.internal for failure in failed)
        return [results[index] for index in range(len(tasks))]

    def _collect(
        self,
        futures: Mapping[Future[Result], int],
        take: Callable[[int, Result | TaskFailure], None],
        look: Callable[[], None],
        meanwhile: Iterator[object],
        interrupts: list[int],
        unit: str,
    ) -> list[int]:
        """Wait for all futures, which map to indices of tasks; returns the indices of tasks whose process died."""
        lost = []
        pending = set(futures)
        answered = False
        while pending:
            busy = not interrupts and next(meanwhile, None) is not None
            finished, pending = wait(pending, 0.0 if busy else _TICK_S, FIRST_COMPLETED)
            look()
            # An executor that is closed meanwhile cancels what waits without telling those who wait for it.
            dropped = {future for future in pending if future.cancelled()}
            finished, pending = finished | dropped, pending - dropped
            for future in sorted(finished, key=futures.__getitem__):
                outcome = self._outcome(future)
                if outcome is None:
                    lost.append(futures[future])
                else:
                    take(futures[future], outcome[0])
            if interrupts and not answered:
                answered = True
                pending = {future for future in pending if not future.cancel()}
                if pending:
                    what = f"{len(pending)} {unit}{'s' if len(pending) > 1 else ''}"
                    self._announce(f"finishing {what}; press again to stop now")
            if len(interrupts) > 1:
                self._kill()
                break
        if interrupts:
            raise KeyboardInterrupt
        return lost

    def _outcome(self, future: Future[Result]) -> tuple[Result | TaskFailure] | None:
        """Result or failure of a task, or None if its process died."""
        try:
            error = future.exception()
        except CancelledError as lost:
            msg = "the connection to the cluster's scheduler was lost; run the same command again to resume"
            raise ModalcamError(msg) from lost
        if error is None:
            return (future.result(),)
        if isinstance(error, self._died):
            return None
        if isinstance(error, ModalcamError):
            raise error
        if isinstance(error, TimeLimitError):
            reason = f"it did not finish within {self._limits.seconds:g} s and was stopped; the file may be damaged, "
            return (TaskFailure(f"{reason}or needs more than --time-limit allows"),)
        if isinstance(error, MemoryError):
            reason = "it needed more memory than a worker process may use; the file may be damaged, "
            return (TaskFailure(f"{reason}or needs more than --memory-limit allows"),)
        reason = f"internal error, please report it: {type(error).__name__}: {error}"
        return (TaskFailure(reason, internal=True),)


@contextmanager
def _collected_interrupts() -> Iterator[list[int]]:
    """Signals of interrupts, collected instead of raising KeyboardInterrupt; only in the main thread."""
    received: list[int] = []
    replaced: list[int] = []
    if threading.current_thread() is threading.main_thread():
        default_handler = signal.default_int_handler
        replaced = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) is default_handler]
    for number in replaced:
        signal.signal(number, lambda number, _: received.append(number))
    try:
        yield received
    finally:
        for number in replaced:
            signal.signal(number, signal.default_int_handler)


# M_MMAP_THRESHOLD of mallopt(3).
_THRESHOLD = -3


def return_large_arrays() -> None:
    """Make the C library return each large array to the system when it is freed.

    That of GNU by default raises the size from which it does so, up to 32 MB, with every array freed. Those of a long
    record then lie in its heap, whose holes are a fifth of the peak. Nothing is done with other C libraries.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_THRESHOLD, TUNING.large_array)


def low_memory_limits() -> str:
    """Why the limits of this process are too low for the libraries; empty where they are not, and on other systems."""
    if sys.platform != "linux":
        return ""
    import resource  # noqa: PLC0415 - other systems have none

    for name, kind, least in (
        ("RLIMIT_DATA, ulimit -d", resource.RLIMIT_DATA, TUNING.least_data),
        ("RLIMIT_AS, ulimit -v", resource.RLIMIT_AS, TUNING.least_address),
    ):
        limit = resource.getrlimit(kind)[0]
        if limit != resource.RLIM_INFINITY and limit < least:
            return (
                f"its libraries need {least // 2**20} MB of memory, but this process may use {limit // 2**20} MB "
                f"({name}); raise the limit, of the shell, container or batch job, to 2 GB or more"
            )
    return ""


def peak_bytes(pid: int) -> int:
    """Largest memory so far of a running process, 0 where the system does not say."""
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text("ascii").splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    return 0

"""A pool of processes that survives a task which kills its process."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Generic, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")

# One thread a process: results must not depend on how many processes share the machine.
_SINGLE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


@dataclass(frozen=True)
class Crashed:
    """A task that raised an unexpected error (`internal`) or killed its process: falsy, with what is known."""

    reason: str
    internal: bool = False

    def __bool__(self) -> bool:
        return False


@contextmanager
def worker_pool(jobs: int) -> Iterator[WorkerPool]:
    """Pool of `jobs` fresh processes; on leaving, tasks not begun are dropped.

    Raises
    ------
    ValueError
        If `jobs` is less than 1.
    """
    if jobs < 1:
        msg = f"expected at least one worker process, got {jobs}"
        raise ValueError(msg)
    before = {name: os.environ.get(name) for name in _SINGLE_THREAD}
    os.environ.update(_SINGLE_THREAD)
    pool = WorkerPool(jobs)
    try:
        yield pool
    finally:
        pool.close()
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


class WorkerPool:
    """Runs a function over tasks in processes of their own; results come in the order of the tasks.

    `internal_errors` counts the tasks so far that raised what they should not.
    """

    def __init__(self, jobs: int) -> None:
        self.internal_errors = 0
        self._jobs = jobs
        self._executor = self._start(jobs)

    def map(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        done: Callable[[int], None] | None = None,
    ) -> list[Result | Crashed]:
        """Result of each task, or `Crashed`; `done` is called with the index of each task as it ends."""
        results: dict[int, Result | Crashed] = {}
        lost = self._attempt(function, dict(enumerate(tasks)), results, done)
        # A process that dies takes the whole pool along: who did it shows when each runs alone.
        for index in sorted(lost):
            if self._attempt(function, {index: tasks[index]}, results, done):
                reason = "the process that worked on it died; the file may be damaged or too large for memory"
                results[index] = Crashed(reason)
                if done is not None:
                    done(index)
        self.internal_errors += sum(isinstance(r, Crashed) and r.internal for r in results.values())
        return [results[index] for index in range(len(tasks))]

    def close(self) -> None:
        """Drop what has not begun and let the processes end."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    def _attempt(
        self,
        function: Callable[[Task], Result],
        tasks: dict[int, Task],
        results: dict[int, Result | Crashed],
        done: Callable[[int], None] | None,
    ) -> list[int]:
        outcome = _Outcome[Result](results, done)
        futures = {}
        for index, task in tasks.items():
            try:
                futures[self._executor.submit(function, task)] = index
            except BrokenProcessPool:
                outcome.lost.append(index)
        for future in as_completed(futures):
            outcome.take(future, futures[future])
        if outcome.lost:
            self._executor.shutdown(wait=True, cancel_futures=True)
            self._executor = self._start(self._jobs)
        return outcome.lost

    @staticmethod
    def _start(jobs: int) -> ProcessPoolExecutor:
        # "spawn": OpenCV and PyAV hold threads, which a fork would copy in an unusable state.
        return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_prepare_process)


class _Outcome(Generic[Result]):
    def __init__(self, results: dict[int, Result | Crashed], done: Callable[[int], None] | None) -> None:
        self.lost: list[int] = []
        self._results = results
        self._done = done

    def take(self, future: Future[Result], index: int) -> None:
        error = future.exception()
        if isinstance(error, BrokenProcessPool):
            self.lost.append(index)
            return
        if error is not None:
            reason = f"internal error, please report it: {type(error).__name__}: {error}"
            self._results[index] = Crashed(reason, internal=True)
        else:
            self._results[index] = future.result()
        if self._done is not None:
            self._done(index)


def _prepare_process() -> None:
    import cv2  # noqa: PLC0415 - only the worker needs it

    cv2.setNumThreads(1)
    # An interrupt is the parent's to handle: what has begun is finished and saved.
    signal.signal(signal.SIGINT, signal.SIG_IGN)

"""Tasks in other processes, here or on a cluster; a task that kills its process or hangs takes no other along."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from modalcam.errors import ModalcamError
from modalcam.execution.local import Limits, LocalExecutor, TimeLimitError, single_threaded_environment

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True)
class TaskFailure:
    """A task that gave no result: falsy, with the reason; `internal` where it raised what it should not."""

    reason: str
    internal: bool = False

    def __bool__(self) -> bool:
        return False


@contextmanager
def worker_pool(jobs: int, limits: Limits | None = None) -> Iterator[WorkerPool]:
    """Pool of `jobs` fresh processes of this machine; on leaving, tasks not begun are dropped.

    Raises
    ------
    ValueError
        If `jobs` is less than 1.
    """
    if jobs < 1:
        msg = f"expected at least one worker process, got {jobs}"
        raise ValueError(msg)
    limits = limits or Limits()
    with single_threaded_environment():
        executor = LocalExecutor(jobs, limits)
        try:
            yield WorkerPool(executor, limits)
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


class WorkerPool:
    """Runs a function over tasks on an executor; results come in the order of the tasks.

    Parameters
    ----------
    executor : Executor
        Its futures raise TimeLimitError for a task that took too long.
    limits : Limits
        What the executor holds each task to, for the texts of failures.
    died : tuple of exception types
        What its futures raise for a task whose process died.

    Attributes
    ----------
    internal_errors : int
        Tasks so far that raised what they should not.
    """

    def __init__(
        self,
        executor: Executor,
        limits: Limits,
        died: tuple[type[BaseException], ...] = (BrokenExecutor,),
    ) -> None:
        self.internal_errors = 0
        self._executor = executor
        self._died = died
        self._limits = limits

    def map(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        done: Callable[[int], None] | None = None,
    ) -> list[Result | TaskFailure]:
        """Result of each task, or `TaskFailure`; `done` is called with the index of each task as it ends.

        A task whose process died is tried once more, after all others and alone: what it lacked may have been memory.

        Raises
        ------
        ModalcamError
            If a task raised it: then it concerns more than that task.
        """
        results: dict[int, Result | TaskFailure] = {}
        lost: list[int] = []

        def take(index: int, future: Future[Result], *, again: bool) -> None:
            outcome = self._outcome(future)
            if outcome is None and again:
                lost.append(index)
                return
            results[index] = TaskFailure(_DIED) if outcome is None else outcome
            if done is not None:
                done(index)

        futures = {self._executor.submit(function, task): index for index, task in enumerate(tasks)}
        for future in as_completed(futures):
            take(futures[future], future, again=True)
        for index in sorted(lost):
            take(index, self._executor.submit(function, tasks[index]), again=False)
        self.internal_errors += sum(isinstance(r, TaskFailure) and r.internal for r in results.values())
        return [results[index] for index in range(len(tasks))]

    def _outcome(self, future: Future[Result]) -> Result | TaskFailure | None:
        """What a task gave, or None where its process died."""
        try:
            error = future.exception()
        except CancelledError as lost:
            msg = "the cluster's scheduler has gone; run the same command again to go on from what was saved"
            raise ModalcamError(msg) from lost
        if error is None:
            return future.result()
        if isinstance(error, self._died):
            return None
        if isinstance(error, ModalcamError):
            raise error
        if isinstance(error, TimeLimitError):
            return TaskFailure(
                f"it was not done after {self._limits.seconds:g} s and was stopped; the file may be damaged, "
                "or needs more than --time-limit allows"
            )
        if isinstance(error, MemoryError):
            return TaskFailure(
                "it needed more memory than a worker process may take; the file may be damaged, "
                "or needs more than --memory-limit allows"
            )
        return TaskFailure(
            f"internal error, please report it: {type(error).__name__}: {error}",
            internal=True,
        )


_DIED = "the process that worked on it died, twice; the file may be damaged or too large for memory"

"""Tasks in other processes, here or on a cluster: failures are values, an interrupt finishes what has begun."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from modalcam.errors import ModalcamError
from modalcam.execution.local import Limits, LocalExecutor, TimeLimitError, single_threaded_environment

Task = TypeVar("Task")
Result = TypeVar("Result")
Announce = Callable[[str], object]

# how soon an interrupt is answered
_TICK_S = 0.1
_DIED = "the process that worked on it died, twice; the file may be damaged or too large for memory"


@dataclass(frozen=True)
class TaskFailure:
    """A task without a result: falsy, with the reason; `internal` if it raised an unexpected exception."""

    reason: str
    internal: bool = False

    def __bool__(self) -> bool:
        return False


@contextmanager
def worker_pool(
    jobs: int,
    limits: Limits | None = None,
    *,
    plugins: tuple[str, ...] = (),
    announce: Announce | None = None,
) -> Iterator[WorkerPool]:
    """Pool of `jobs` processes of this machine, started when needed; on leaving, tasks not begun are dropped.

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
        executor = LocalExecutor(jobs, limits, plugins)
        try:
            yield WorkerPool(executor, limits, kill=executor.kill, announce=announce)
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


class WorkerPool:
    """Runs a function over tasks on an executor; results come in the order of the tasks.

    Parameters
    ----------
    executor : Executor
        Its futures raise TimeLimitError for a task that exceeded its time limit.
    limits : Limits
        Those that the executor enforces, for the texts of failures.
    died : tuple of exception types
        What its futures raise for a task whose process died.
    kill : callable, optional
        Ends all tasks at once, for the second interrupt; by default only tasks not begun are dropped.
    announce : callable, optional
        Shows the answer to an interrupt; by default it is written to standard error.

    Attributes
    ----------
    failures : int
        Tasks so far that gave no result.
    internal_errors : int
        Those of them that raised an unexpected exception.
    """

    def __init__(
        self,
        executor: Executor,
        limits: Limits,
        *,
        died: tuple[type[BaseException], ...] = (BrokenExecutor,),
        kill: Callable[[], object] | None = None,
        announce: Announce | None = None,
    ) -> None:
        self.failures = 0
        self.internal_errors = 0
        self._executor = executor
        self._limits = limits
        self._died = died
        self._kill = kill or (lambda: executor.shutdown(wait=False, cancel_futures=True))
        self._announce = announce or (lambda text: sys.stderr.write(f"{text}\n"))

    def map(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        done: Callable[[int], None] | None = None,
        *,
        unit: str = "recording",
    ) -> list[Result | TaskFailure]:
        """Result of each task, or `TaskFailure`.

        A task whose process died is tried once more, after all others and alone: memory may have been short.

        Parameters
        ----------
        function : callable
            Importable by name in a new process.
        tasks : sequence
        done : callable, optional
            Called with the index of each task as it ends.
        unit : str
            What a task is, for the answer to an interrupt.

        Raises
        ------
        ModalcamError
            If a task raised it: it concerns more than that task.
        KeyboardInterrupt
            After an interrupt (SIGINT, or SIGTERM where that raises KeyboardInterrupt): tasks that have begun end
            first, others are dropped; a second interrupt kills those that have begun.
        """
        results: dict[int, Result | TaskFailure] = {}

        def take(index: int, result: Result | TaskFailure) -> None:
            results[index] = result
            if done is not None:
                done(index)

        with _CountedInterrupts() as interrupts:
            todo = {self._executor.submit(function, task): index for index, task in enumerate(tasks)}
            for index in sorted(self._collect(todo, take, interrupts, unit)):
                again = {self._executor.submit(function, tasks[index]): index}
                if self._collect(again, take, interrupts, unit):
                    take(index, TaskFailure(_DIED))
        failed = [result for result in results.values() if isinstance(result, TaskFailure)]
        self.failures += len(failed)
        self.internal_errors += sum(failure.internal for failure in failed)
        return [results[index] for index in range(len(tasks))]

    def _collect(
        self,
        futures: Mapping[Future[Result], int],
        take: Callable[[int, Result | TaskFailure], None],
        interrupts: _CountedInterrupts,
        unit: str,
    ) -> list[int]:
        """Wait for all futures, which map to indices of tasks; returns the indices of tasks whose process died."""
        lost = []
        pending = set(futures)
        answered = False
        while pending:
            finished, pending = wait(pending, _TICK_S, FIRST_COMPLETED)
            for future in sorted(finished, key=futures.__getitem__):
                outcome = self._outcome(future)
                if outcome is None:
                    lost.append(futures[future])
                else:
                    take(futures[future], outcome[0])
            if interrupts.count and not answered:
                answered = True
                pending = {future for future in pending if not future.cancel()}
                if pending:
                    what = f"{len(pending)} {unit}{'s' if len(pending) > 1 else ''}"
                    self._announce(
                        f"finishing {what}; press again to drop {'them' if len(pending) > 1 else 'it'}"
                    )
            if interrupts.count > 1:
                self._kill()
                break
        if interrupts.count:
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


class _CountedInterrupts:
    """While open, interrupts are counted instead of raising KeyboardInterrupt; only in the main thread."""

    def __init__(self) -> None:
        self.count = 0
        self._replaced: list[int] = []

    def __enter__(self) -> _CountedInterrupts:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                if signal.getsignal(number) is signal.default_int_handler:
                    signal.signal(number, self._note)
                    self._replaced.append(number)
        return self

    def __exit__(self, *_: object) -> None:
        for number in self._replaced:
            signal.signal(number, signal.default_int_handler)

    def _note(self, *_: object) -> None:
        self.count += 1

"""Tasks in other processes, local or on a cluster: failures are values, an interrupt lets running tasks finish."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from modalcam.errors import ModalcamError
from modalcam.execution.local import SINGLE_THREAD, Limits, LocalExecutor, TimeLimitError

Task = TypeVar("Task")
Result = TypeVar("Result")
Announce = Callable[[str], object]

# longest time until an interrupt is noticed
_TICK_S = 0.1
_DIED = "the process that worked on it died, twice; the file may be damaged or too large for memory"


@dataclass(frozen=True)
class TaskFailure:
    """A task without a result: falsy, with the reason; `internal` if it raised an unexpected exception."""

    reason: str
    internal: bool = False

    def __bool__(self) -> bool:
        return False


class Progress:
    """Listener to the stages of a run, which shows nothing. Calls come from the thread that runs the pipeline."""

    def begin(self, stage: str, total: int) -> None:
        """`stage` starts with `total` tasks."""

    def advance(self, name: str, *, reused: bool = False) -> None:
        """The task `name`, if it has one, of the current stage has ended; `reused` if its saved result was valid."""

    def within(self, name: str, frames: int, declared: int) -> None:
        """The task `name` of the current stage has begun; if it counts them, `frames` of `declared` are done."""

    def say(self, text: str) -> None:
        """Show a message now, such as the response to an interrupt."""

    def note(self, text: str) -> None:
        """Show a message that is neither a failure nor a warning."""
        self.say(text)


@contextmanager
def worker_pool(
    jobs: int,
    limits: Limits | None = None,
    *,
    plugins: tuple[str, ...] = (),
    announce: Announce | None = None,
) -> Iterator[WorkerPool]:
    """Pool of `jobs` processes of this machine, started when needed; on leaving, tasks not begun are dropped."""
    if jobs < 1:
        msg = f"expected at least one worker process, got {jobs}"
        raise ValueError(msg)
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

import os
import sys
from concurrent.futures import Executor, Future

import pytest
from support.worker_tasks import GIBI, behave

from modalcam.common import ModalcamError
from modalcam.pipeline import Limits, TaskFailure, WorkerPool, worker_pool


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_task_that_kills_its_process_does_not_stop_the_others(jobs):
    done = []
    with worker_pool(jobs) as pool:
        results = pool.map(behave, ["a", "die", "b", "raise", "c"], done=done.append)
        again = pool.map(behave, ["d"])
    assert [r[0] if r else r for r in results][::2] == ["A", "B", "C"]
    assert isinstance(results[1], TaskFailure)
    assert "died, twice" in results[1].reason
    assert not results[1].internal
    assert isinstance(results[3], TaskFailure)
    assert "broken task" in results[3].reason
    assert results[3].internal
    assert pool.internal_errors == 1
    assert again == [("D", "1")]
    assert sorted(done) == [0, 1, 2, 3, 4]


def test_a_task_whose_process_died_is_retried_once(tmp_path):
    with worker_pool(2) as pool:
        results = pool.map(behave, ["a", f"die-once {tmp_path / 'died'}", "b"])
    assert [r[0] for r in results] == ["A", "DIE-ONCE", "B"]
    assert (tmp_path / "died").exists()


def test_this_process_works_while_tasks_run(tmp_path):
    """The task ends only after the second step of this process."""
    path = tmp_path / "second"

    def steps():
        yield "first"
        path.touch()
        yield "second"

    with worker_pool(1, Limits(seconds=60.0)) as pool:
        waited = pool.map(behave, [f"wait-for {path}"], meanwhile=steps())
        assert waited == [("WAIT-FOR", "1")], "no step was taken"
        untouched = steps()
        assert pool.map(behave, [], meanwhile=untouched) == []
        assert next(untouched) == "first", "a step was taken although there was no task"


def test_a_task_that_hangs_is_stopped_with_a_reason():
    # The time of a task does not include the start and the imports of its process.
    with worker_pool(2, Limits(seconds=3.0)) as pool:
        hung, own, fine = pool.map(behave, ["hang", "own-timeout", "a"])
        after = pool.map(behave, ["b", "c"])
    assert isinstance(hung, TaskFailure)
    assert "did not finish within 3 s" in hung.reason
    assert "--time-limit" in hung.reason
    assert not hung.internal
    # A TimeoutError raised by the task itself is not the time limit.
    assert isinstance(own, TaskFailure)
    assert own.internal
    assert fine[0] == "A"
    assert [r[0] for r in after] == ["B", "C"]


@pytest.mark.skipif(not hasattr(os, "sysconf"), reason="the system has no limits for a process")
def test_a_task_over_the_memory_limit_fails_alone():
    with worker_pool(1, Limits(memory_bytes=2 * GIBI)) as pool:
        results = pool.map(behave, ["allocate 0.5", "allocate 3", "a"])
    assert results[0][0] == str(GIBI // 2)
    assert isinstance(results[1], TaskFailure)
    assert "--memory-limit" in results[1].reason
    assert not results[1].internal
    assert results[2][0] == "A"


@pytest.mark.skipif(
    sys.platform != "linux", reason="other systems do not say how much memory a process has needed"
)
def test_a_process_that_needed_much_memory_is_not_used_for_the_next_stage():
    with worker_pool(1) as pool:
        small = [pid for _ in range(2) for _, pid in pool.map(behave, ["allocate 0.05"])]
        large = [pid for _, pid in pool.map(behave, ["allocate 0.6", "allocate 0.01"])]
        (after,) = (pid for _, pid in pool.map(behave, ["allocate 0.01"]))
    assert small == 2 * large[:1], "starting a process takes seconds: it is kept while it stays small"
    assert large[0] == large[1], "the tasks of one stage need the same libraries"
    assert after != large[0], "0.6 GiB are more than the 400 MiB above which a process is replaced"


def test_the_environment_is_restored():
    before = dict(os.environ)
    with worker_pool(1):
        pass
    assert dict(os.environ) == before


def test_zero_workers_and_zero_limits_are_errors():
    with pytest.raises(ValueError, match="at least 1"), worker_pool(0):
        pass
    with pytest.raises(ValueError, match="time limit"):
        Limits(seconds=0.0)
    with pytest.raises(ValueError, match="memory limit"):
        Limits(memory_bytes=0)


class LostScheduler(Executor):
    """Cancels every task, as the executor of a cluster does when the scheduler is lost."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.cancel()
        future.set_running_or_notify_cancel()
        return future


def test_an_executor_that_cancels_its_tasks_ends_the_run():
    with pytest.raises(ModalcamError, match="scheduler was lost; run the same command again"):
        WorkerPool(LostScheduler().submit, Limits()).map(behave, ["a", "b"])


@pytest.mark.timeout(60)
def test_tasks_that_a_closing_executor_cancels_end_the_wait():
    """`concurrent.futures.wait` alone would wait forever: it is told of a cancelled task only when one takes it up."""
    future = Future()
    future.cancel()
    with pytest.raises(ModalcamError, match="run the same command again"):
        WorkerPool(lambda function, task: future, Limits()).map(str, [1])

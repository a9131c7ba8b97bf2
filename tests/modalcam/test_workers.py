import os
import signal

import pytest

from modalcam.workers import Crashed, worker_pool


def behave(task):
    if task == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if task == "raise":
        msg = "broken task"
        raise RuntimeError(msg)
    return task.upper(), os.environ["OMP_NUM_THREADS"]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_task_that_kills_its_process_does_not_take_the_others_along(jobs):
    done = []
    with worker_pool(jobs) as pool:
        results = pool.map(behave, ["a", "die", "b", "raise", "c"], done=done.append)
        again = pool.map(behave, ["d"])
    assert [r[0] if r else r for r in results][::2] == ["A", "B", "C"]
    assert isinstance(results[1], Crashed)
    assert "died" in results[1].reason
    assert isinstance(results[3], Crashed)
    assert "broken task" in results[3].reason
    assert again == [("D", "1")]
    assert sorted(done) == [0, 1, 2, 3, 4]


def test_the_environment_is_left_as_it_was():
    before = dict(os.environ)
    with worker_pool(1):
        pass
    assert dict(os.environ) == before


def test_no_workers_is_an_error():
    with pytest.raises(ValueError, match="at least one"), worker_pool(0):
        pass

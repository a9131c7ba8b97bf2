"""The run of a studio: what its lines of progress mean, and the process itself."""

import json
import time

import pytest
from kit.films import write_decay

from modalcam.apps.studio import Runner, RunState
from modalcam.common import ExitCode, ModalcamError


def line(**values):
    return json.dumps(values) + "\n"


def test_progress_is_counted_by_stage():
    state = RunState(0.0)
    assert state.stage.name == "starting"
    state.take(line(event="begin", stage="identifying", total=4), 10.0)
    assert state.remaining_s(11.0) is None
    state.take(line(event="advance", name="a", reused=True), 10.1)
    assert state.remaining_s(11.0) is None, "what is reused takes no time and gives no pace"
    state.take(line(event="advance", name="b", reused=False), 14.0)
    stage = state.stage
    assert (stage.name, stage.done, stage.reused, stage.computed) == ("identifying", 2, ["a"], ["b"])
    assert [stage.state_of(name, is_running=True) for name in "abc"] == ["reused", "done", "to do"]
    assert state.remaining_s(14.0) == 8.0  # one of three in 4 s
    # 12 s for 18 % of a run, and without a beam another 20 % comes after it
    assert state.rest_of_run_s(14.0) == pytest.approx(8.0 + 12.0 * 20.0 / 18.0)
    state.take(line(event="begin", stage="writing", total=1), 20.0)
    assert state.stage.done == 0
    state.exit_code, state.ended_s = int(ExitCode.OK), 25.0
    assert state.elapsed_s(99.0) == 25.0
    assert state.remaining_s(99.0) is None
    assert state.outcome == "finished"
    assert stage.state_of("c", is_running=False) == ""


def test_the_pace_of_tracking_is_that_of_frames():
    """1000 frames in 4 s: the 2000 and 500 of the rest take 10 s, of which 1 s has passed."""
    state = RunState(0.0, {"a": 100, "b": 1000, "c": 2000, "d": 500})
    state.take(line(event="begin", stage="tracking", total=4), 10.0)
    state.take(line(event="advance", name="a", reused=True), 10.0)
    assert state.frames_per_s() is None
    state.take(line(event="advance", name="b", reused=False), 14.0)
    assert state.frames_per_s() == 250.0
    assert state.remaining_s(15.0) == 9.0
    assert state.remaining_s(60.0) == 0.0


def test_the_pace_is_known_within_the_first_recording():
    """500 frames in 2 s: the other 1500 of this one and the 3000 of the next take 18 s."""
    state = RunState(0.0, {"a": 2000, "b": 3000})
    state.take(line(event="begin", stage="tracking", total=2), 10.0)
    state.take(line(event="within", name="a", frames=0), 10.1)
    assert state.frames_per_s() is None
    assert state.stage.state_of("a", is_running=True, frames=2000) == "working"
    state.take(line(event="within", name="a", frames=500), 12.0)
    assert state.frames_per_s() == 250.0
    assert state.remaining_s(12.0) == 18.0
    assert state.share == 0.125, "a quarter of the first of two"
    assert [state.stage.state_of(n, is_running=True, frames=2000) for n in "ab"] == ["25 %", "to do"]
    state.take(line(event="advance", name="a", reused=False), 18.0)
    assert state.frames_per_s() == 250.0
    assert state.stage.state_of("a", is_running=True, frames=2000) == "done"


@pytest.mark.parametrize("text", ["warning of a library\n", "{\n", "[1]\n", '{"other": 1}\n'])
def test_a_line_of_something_else_is_a_message(text):
    state = RunState()
    state.take(text, 0.0)
    assert state.messages == [text.rstrip()]


def test_a_process_that_died_is_said_so():
    assert "died (exit code -9)" in RunState(exit_code=-9).outcome


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the run did not get there"
        time.sleep(0.05)


def test_a_run_that_cannot_begin_says_why_and_another_can_follow(tmp_path):
    runner = Runner()
    for _ in range(2):
        runner.start(tmp_path / "absent", tmp_path / "out")
        with pytest.raises(ModalcamError, match="going on already"):
            runner.start(tmp_path, tmp_path)
        wait_for(lambda: not runner.is_running)
        assert runner.state.exit_code == ExitCode.USAGE
        assert "no such folder" in runner.state.messages[-1]
        assert runner.state.outcome == "not started"


def test_closing_ends_the_process(tmp_path):
    runner = Runner()
    runner.start(tmp_path, tmp_path / "out")
    runner.close()
    wait_for(lambda: not runner.is_running)
    assert runner.state.exit_code in (ExitCode.INTERRUPTED, ExitCode.NO_INPUT, ExitCode.USAGE)
    runner.close()


@pytest.mark.slow  # the reduced version, which ends before anything is computed, is above
@pytest.mark.timeout(900)
@pytest.mark.parametrize("end", ["cancel", "close"])
def test_a_run_that_is_ended_loses_nothing_and_can_be_repeated(tmp_path, end):
    folder, out = write_decay(tmp_path / "videos"), tmp_path / "out"
    runner = Runner()
    runner.start(folder, out)
    wait_for(lambda: runner.state.stage.name == "identifying" or not runner.is_running, 300)
    getattr(runner, end)()
    wait_for(lambda: not runner.is_running, 300)
    assert runner.state.exit_code == ExitCode.INTERRUPTED, runner.state
    assert not (out / "report.html").exists()
    kept = {path.name: path.read_bytes() for path in (out / "state").glob("*.npz")}
    assert any("tracks" in name for name in kept), "the tracks were finished before the run was ended"
    runner.start(folder, out)
    wait_for(lambda: not runner.is_running, 300)
    assert runner.state.exit_code == ExitCode.OK, runner.state
    assert (out / "report.html").exists()
    assert all((out / "state" / name).read_bytes() == data for name, data in kept.items())
    runner.start(folder, out)
    wait_for(lambda: not runner.is_running, 300)
    assert "up to date" in runner.state.messages

"""A stage computes results with changed inputs and reuses others; a failed task gives a falsy result."""

from dataclasses import replace
from pathlib import Path

import pytest
from support.worker_tasks import Inline, counted

from modalcam import plugins
from modalcam.config import ExperimentConfig
from modalcam.pipeline import (
    RUN,
    AddedStage,
    Context,
    InputFile,
    Limits,
    RecordingResult,
    RunRecord,
    RunResult,
    Stage,
    WorkerPool,
    Workspace,
    compare_recordings,
    register_stage,
    run_together,
    update_beam,
    worker_pool,
)
from sim import paper_beam
from tracker import FailedTracking


class Listener:
    """Records the reports of a stage."""

    def __init__(self):
        self.calls = []

    def begin(self, stage, total):
        self.calls.append((stage, total))

    def advance(self, name, *, reused=False):
        self.calls.append((name, "reused" if reused else "computed"))

    def within(self, name, frames, declared):
        self.calls.append((name, frames, declared))

    def say(self, text):
        self.calls.append(text)


def not_tracked(name, reason):
    return FailedTracking(reason, name)


def scaled(recording, factor):
    if factor < 0:
        msg = "below zero"
        raise RuntimeError(msg)
    return (recording.name, factor)


SCALING = Stage("scaling", "scaled", ("modalcam.common",), scaled, not_tracked)


@pytest.fixture
def context(tmp_path):
    workspace = Workspace(tmp_path / "out")
    workspace.prepare(inputs=None, force=False)
    pool = WorkerPool(Inline().submit, Limits())
    return Context(ExperimentConfig(), workspace, pool, Listener(), seed=0, force=False)


def inputs(tmp_path, **changes):
    given = {"recording": InputFile(tmp_path / "a.avi", "00"), "factor": 2.0} | changes
    return {"a": given, "b": {**given, "factor": 3.0}}


def test_only_results_with_a_changed_input_are_computed_again(context, tmp_path):
    first = SCALING.run(context, inputs(tmp_path))
    assert first == {"a": ("a.avi", 2.0), "b": ("a.avi", 3.0)}
    assert context.progress.calls == [("scaling", 2), ("a", "computed"), ("b", "computed")]
    keys = {name: dict(files) for name, files in context.results.items()}
    context.progress.calls.clear()
    # Only the content of a recording matters, not its path.
    moved = InputFile(tmp_path / "elsewhere" / "a.avi", "00")
    changed = inputs(tmp_path, recording=moved)
    changed["b"]["factor"] = 4.0
    assert SCALING.run(context, changed)["b"] == ("a.avi", 4.0)
    assert context.progress.calls == [("scaling", 2), ("a", "reused"), ("b", "computed")]
    assert context.results["a"] == keys["a"]
    assert context.results["b"] != keys["b"]


class Backwards(WorkerPool):
    """The last task ends first."""

    def map(self, function, tasks, done=None, **others):
        order = list(range(len(tasks)))[::-1]
        results = super().map(function, [tasks[i] for i in order], lambda at: done(order[at]), **others)
        return results[::-1]


def test_stages_that_run_together_are_shown_one_after_the_other(context, tmp_path):
    shrinking = replace(SCALING, name="shrinking", file="shrunk")
    backwards = replace(context, pool=Backwards(Inline().submit, Limits()))
    given = inputs(tmp_path)
    parts = ((SCALING, given), (shrinking, {"b": given["b"]}), (replace(SCALING, name="nothing"), {}))
    expected = [{"a": ("a.avi", 2.0), "b": ("a.avi", 3.0)}, {"b": ("a.avi", 3.0)}, {}]
    assert run_together(backwards, *parts) == expected
    calls = [("scaling", 2), ("b", "computed"), ("a", "computed"), ("shrinking", 1), ("b", "computed")]
    assert context.progress.calls == calls
    assert {name: sorted(files) for name, files in context.results.items()} == {
        "a": ["scaled"],
        "b": ["scaled", "shrunk"],
    }
    context.progress.calls.clear()
    assert run_together(backwards, *parts) == expected
    assert {outcome for name, outcome in context.progress.calls if name in "ab"} == {"reused"}


def test_stages_of_plugins_run_without_a_beam_or_say_that_they_did_not(context, monkeypatch):
    monkeypatch.setattr("modalcam.pipeline.stage.ADDED_STAGES", {})
    given = {"recording": InputFile(Path("a.avi"), "00"), "factor": 2.0}
    for name, file, beside in (("weighing", "weighed", "updating"), ("loading", "loaded", "simulating")):
        register_stage(AddedStage(replace(SCALING, name=name, file=file), beside, lambda *_: given))
    take = RecordingResult("a", "a.avi", "00", None)
    beam, notes, (measured,) = update_beam(context, [take], "There is no [beam].")
    assert beam is None
    assert notes == ("There is no [beam].",)
    assert measured.added == {"weighed": ("a.avi", 2.0)}
    assert set(context.results["a"]) == {"weighed"}
    recordings, skipped = compare_recordings(context, [measured], beam)
    assert recordings == [measured]
    assert skipped == ("Without an updated beam, loading was skipped.",)


class Noticing(Listener):
    """Lets the task end once its frames have been reported."""

    def __init__(self, seen):
        super().__init__()
        self.seen = seen

    def within(self, name, frames, declared):
        super().within(name, frames, declared)
        if frames:
            self.seen.touch()


def test_the_frames_of_a_task_are_reported_while_it_goes_on(context, tmp_path):
    seen = tmp_path / "seen"
    stage = Stage("counting", "counted", ("modalcam.common",), counted, not_tracked, counts_frames=True)
    with worker_pool(1) as pool:
        live = replace(context, pool=pool, progress=Noticing(seen))
        given = {"recording": InputFile(tmp_path / "a.avi", "00"), "seen": str(seen)}
        assert stage.run(live, {"a": given}) == {"a": "a.avi"}
    calls = live.progress.calls
    assert calls[0] == ("counting", 1)
    assert calls[-1] == ("a", "computed")
    # Every eighth frame is written; before the first of them, that the task has begun.
    assert set(calls[1:-1]) <= {("a", 0, 0), ("a", 8, 30), ("a", 16, 30)}
    assert ("a", 16, 30) in calls
    assert not list(context.workspace.out.rglob(".tmp-*")), "nothing is left of the counts"


def test_a_run_whose_results_are_replaced_is_not_up_to_date(context, tmp_path):
    SCALING.run(context, inputs(tmp_path))
    finished = RunRecord("f", (), ExperimentConfig(), 0, "modalcam run f", key="finished")
    context.workspace.write_record(finished)
    SCALING.run(context, inputs(tmp_path))
    assert context.workspace.read_record() == finished
    SCALING.run(context, inputs(tmp_path, factor=5.0))
    assert context.workspace.read_record() == replace(finished, key="")


@pytest.mark.parametrize("change", ["content", "code", "plugin", "force"])
def test_a_change_of_any_input_computes_the_result_again(context, tmp_path, monkeypatch, change):
    SCALING.run(context, inputs(tmp_path))
    context.progress.calls.clear()
    given = inputs(tmp_path)
    stage = SCALING
    if change == "content":
        given = inputs(tmp_path, recording=InputFile(tmp_path / "a.avi", "01"))
    elif change == "code":
        stage = Stage("scaling", "scaled", ("modalcam.plugins",), scaled, not_tracked)
    elif change == "plugin":
        monkeypatch.setitem(plugins._LOADED, "a_plugin", "0" * 64)
    else:
        context = Context(**vars(context) | {"force": True})
    stage.run(context, given)
    assert [outcome for _, outcome in context.progress.calls[1:]] == ["computed", "computed"]


def test_a_failed_task_gives_a_falsy_result_that_is_not_saved(context, tmp_path):
    broken = Inline(errors=True)
    context = Context(**vars(context) | {"pool": WorkerPool(broken.submit, Limits())})
    result = SCALING.run(context, inputs(tmp_path, factor=-1.0))
    assert result["a"] == FailedTracking("internal error, please report it: RuntimeError: below zero", "a")
    assert result["b"]
    assert list(context.results) == ["b"]
    assert not context.workspace.state("a", "scaled").exists()
    assert context.pool.failures == context.pool.internal_errors == 1


def test_a_stage_of_the_run_has_one_result(context):
    stage = Stage("beam", "beam", ("sim",), paper_beam, not_tracked)
    for expected in ("computed", "reused"):
        assert stage.once(context, orientation="hanging").orientation == "hanging"
        assert context.progress.calls[-1] == ("beam", expected)
    assert list(context.results) == [RUN]


def test_results_have_short_reprs_and_are_loaded_on_first_use():
    failed = RecordingResult("a", "a.avi", "", None, tracks=FailedTracking("no marker", "a.avi"))
    assert failed.failure == "no marker"
    assert repr(failed) == "<RecordingResult a: no marker>"
    loads = []

    def load():
        loads.append(1)
        return {"recordings": (failed,), "beam": None, "added": {}}

    fields = {"not_done": (), "resolved_config": "", "versions": (), "command_line": "", "seed": 0}
    run = RunResult.saved(load, folder="videos", **fields)
    assert (run.folder, run.internal_errors, loads) == ("videos", 0, [])
    assert repr(run) == "<RunResult videos: 1 recordings>\n  <RecordingResult a: no marker>"
    assert run.beam is None
    assert loads == [1]
    assert run == RunResult(folder="videos", recordings=(failed,), beam=None, **fields)
    with pytest.raises(AttributeError, match="absent"):
        _ = run.absent
    assert run.to_dataframe().empty
    assert "frequency_hz" in run._repr_html_()

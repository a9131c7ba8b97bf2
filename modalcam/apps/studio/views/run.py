"""Run and test track: progress, outcome and report of the one; trails, errors and advice of the other."""

from __future__ import annotations

import time
from base64 import b64encode
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from nicegui import background_tasks, ui

from modalcam.apps.studio.frames import marked, trail
from modalcam.apps.studio.next_step import Rank, ranked
from modalcam.apps.studio.run import MODE_COLUMNS, RunResults, RunState, StageState
from modalcam.apps.studio.trial import MOST_LISTED, FollowedWindow, evenly, summarised
from modalcam.apps.studio.views.shared import (
    PageState,
    SaveDialog,
    heading,
    in_thread,
    number,
    remark,
    scrolled,
    table,
    table_head,
)
from modalcam.common import ExitCode, shown
from modalcam.pace import duration
from tracker import FailedTracking, Failure

if TYPE_CHECKING:
    from modalcam.apps.studio.decay import ExpectedIntervals

_TICK_S = 0.3
# Rows of the table of stages.
_MOST_ROWS = 100
# Names in the picture, where those of the stations of a line would lie over each other, and of tasks that go on.
_MOST_NAMED = 8


class RunView:
    """Buttons, progress and report."""

    def __init__(self, state: PageState, save: SaveDialog) -> None:
        self._state = state
        self._save = save
        self._was_running = False
        heading("Run and report")
        with ui.row().classes("frames"):
            self._start = ui.button("Save and run", on_click=self._ask)
            self._cancel = ui.button("Cancel the run", on_click=state.studio.runner.cancel)
        self._stage = ui.label("").props('role="status"').classes("status")
        self._bar = ui.linear_progress(0.0, show_value=False).props('aria-label="Progress of the stage"')
        self._shown: tuple[object, ...] = ()
        self._cells: dict[tuple[str, int], Any] = {}
        self._stages()
        self._messages = ui.element("div").classes("messages")
        self._messages.props('tabindex="0" role="region" aria-label="Messages of the run"')
        self._said: list[str] = []
        self._report = ui.element("div").classes("report")
        ui.timer(0.1, self._show_report, once=True)
        ui.timer(_TICK_S, self._look)
        self._look()

    def _ask(self) -> None:
        self._save.ask(self._run, "Save and run")

    def _run(self) -> None:
        self._state.attempt(self._state.studio.start_run)

    def _look(self) -> None:
        run = self._state.studio.runner.state
        running = run is not None and run.is_running
        self._start.set_enabled(not running)
        self._cancel.set_enabled(running)
        self._bar.visible = running
        self._messages.visible = run is not None and bool(run.messages)
        # That of the run before.
        self._report.visible = not running
        if run is not None:
            self._tell(run)
        was_running, self._was_running = self._was_running, running
        if was_running and not running:
            background_tasks.create(self._show_report())

    def _tell(self, run: RunState) -> None:
        now_s = time.monotonic()
        stage = run.stage
        if run.is_running:
            left_s, pace = run.rest_of_run_s(now_s), run.frames_per_s()
            parts = [
                f"{stage.name}: {stage.done} of {stage.total}" if stage.total else stage.name,
                f"working on {', '.join([*stage.working][:_MOST_NAMED])}" if stage.working else "",
                f"{run.elapsed_s(now_s):.0f} s",
                "" if pace is None else f"{pace:.0f} frames a second",
                "" if left_s is None else f"about {duration(left_s)} left",
                "it ends after what it works on; press again to stop at once" if run.cancelled else "",
            ]
            self._stage.text = ", ".join(filter(None, parts))
            self._bar.value = run.share
            # It moves where the tasks of a stage are not counted in frames, and none has ended.
            self._bar.props["indeterminate"] = not run.share
        else:
            self._stage.text = f"The run took {run.elapsed_s(now_s):.0f} s: {run.outcome}."
        if self._said != run.messages:
            self._said = run.messages
            self._messages.clear()
            with self._messages:
                for rank, text in ranked(run.messages):
                    remark(rank, text)
        self._show_stages(run)

    def _show_stages(self, run: RunState) -> None:
        """Fill in the table in place: one that was built anew would lose the focus."""
        names = {found.name for found in self._state.studio.recordings[:_MOST_ROWS]}
        stages = [s for s in run.stages if names & {*s.computed, *s.reused, *s.working}]
        columns = (id(run), *(stage.name for stage in stages))
        if columns != self._shown:
            self._shown = columns
            self._cells = {}
            self._stages.refresh(stages)
        for (name, k), cell in self._cells.items():
            cell.text = stages[k].state_of(name, is_running=run.is_running, frames=run.frames.get(name))

    @ui.refreshable_method
    def _stages(self, stages: Sequence[StageState] = ()) -> None:
        """What has become of each recording in each stage that works on recordings one by one."""
        if not stages:
            return
        config = self._state.studio.draft.config
        with scrolled(), ui.element("table").classes("list"):
            table_head(("recording", *(stage.name for stage in stages)))
            with ui.element("tbody"):
                for found in self._state.studio.recordings[:_MOST_ROWS]:
                    if config.for_recording(found.file).leave_out:
                        continue
                    with ui.element("tr"):
                        with ui.element("th").props('scope="row"'):
                            ui.label(shown(found.file))
                        for k in range(len(stages)):
                            with ui.element("td"):
                                self._cells[found.name, k] = ui.label("")

    async def _show_report(self) -> None:
        studio = self._state.studio
        found = None if studio.report() is None else await in_thread(studio.results)
        self._report.clear()
        if found is None:
            return
        with self._report:
            run = self._state.studio.runner.state
            is_of_run = run is None or run.exit_code in (ExitCode.OK, ExitCode.PARTIAL)
            heading("Modes" if is_of_run else "Modes of an earlier run", 3)
            _results(found)
            heading("Report" if is_of_run else "Report of an earlier run", 3)
            # A new address each time: the page in the frame is otherwise the one before.
            frame = ui.element("iframe").classes("report-frame")
            frame.props["src"] = f"/report?{time.time_ns()}"
            frame.props["title"] = "Report"
            # Its scripts run without the origin of this page: they reach neither the page nor the studio.
            frame.props["sandbox"] = "allow-scripts"


def _results(found: RunResults | Failure) -> None:
    if isinstance(found, Failure):
        ui.label(shown(found.reason)).classes("problem")
        return
    for file, reason in found.failures:
        remark(Rank.BLOCKING, f"{file}: {reason}")
    table(MODE_COLUMNS, [tuple(map(shown, row)) for row in found.rows])
    if any("†" in cell for row in found.rows for cell in row):
        ui.label("† below 50 ppm, the error of a clock: give its tolerance, under Recordings")


_LENGTHS = {64: "64 frames", 128: "128 frames", 300: "300 frames", 10**9: "all frames"}
_TRIAL_TICK_S = 0.5
_COLUMNS = (
    "marker",
    "sd / px",
    "sd / mm",
    "motion, peak to peak / px",
    "largest step between frames / px",
    "blur / px",
    "lost / %",
    "unexplained / %",
)
_EXPECTED_COLUMNS = ("damping ratio / %", "frequency / Hz", "damping ratio / % of its value")


class TrialView:
    """Button, picture and tables."""

    def __init__(self, state: PageState) -> None:
        self._state = state
        # Of the recording that is tracked.
        self._at, self._began_s = 0, 0.0
        self._look = ui.timer(_TRIAL_TICK_S, self._tell, active=False)
        heading("Test track")
        ui.label(
            "Tracks some frames with the markers as they are now, saved or not. A decay that begins later is seen "
            "from a later frame on."
        )
        with ui.row().classes("frames"):
            self._length = (
                ui.select(_LENGTHS, value=128, label="Length").props("outlined dense").classes("number")
            )
            self._first = number("From frame", value=0, min=0, step=1, format="%d")
            self._button = ui.button("Track", on_click=self._track)
            self._cancel = ui.button("Cancel", on_click=state.studio.cancel_trial)
            self._cancel.visible = False
            self._gain = number("Motion enlarged", value=10, min=1, max=1000, on_change=self._result.refresh)
        self._status = ui.label("").props('role="status"').classes("status")
        self._bar = ui.linear_progress(0.0, show_value=False).props('aria-label="Progress of the test track"')
        self._bar.visible = False
        self._result()
        state.when_recording_changes(self._clear)
        self._clear()

    def _clear(self) -> None:
        self._status.text = shown(self._state.file)
        self._result.refresh()

    def _tell(self) -> None:
        done, total = self._state.studio.frames_tracked()
        self._bar.value = done / total if total else 0.0
        self._bar.props["indeterminate"] = not done
        what = f"{done} of {total} frames tracked" if done else "learning the markers"
        file = self._state.studio.recordings[self._at].file
        self._status.text = f"{shown(file)}: {what}, {time.monotonic() - self._began_s:.0f} s"

    def _set_busy(self, *, is_busy: bool) -> None:
        self._look.active = is_busy
        self._bar.visible = self._cancel.visible = is_busy
        self._button.set_enabled(not is_busy)

    async def _track(self) -> None:
        at = self._at = self._state.number
        self._began_s = time.monotonic()
        self._set_busy(is_busy=True)
        self._result.refresh()
        first = max(int(self._first.value or 0), 0)
        trial = await in_thread(self._state.studio.track_some, at, self._length.value, first)
        self._set_busy(is_busy=False)
        if at != self._state.number:
            return
        if isinstance(trial, FailedTracking):
            self._status.text = shown(trial.reason)
        else:
            frames, markers = trial.tracks.x_px.shape
            listed = f", {MOST_LISTED} of them shown" if markers > MOST_LISTED else ""
            begin = f" from frame {first}" if first else ""
            self._status.text = (
                f"{frames} frames of {shown(self._state.file)}{begin}, {markers} markers{listed}"
            )
        self._result.refresh()
        await in_thread(self._state.studio.expect, at)
        if at == self._state.number:
            self._result.refresh()

    @ui.refreshable_method
    def _result(self) -> None:
        last = self._state.studio.trial(self._state.number)
        # Of other markers, perhaps, while it is tracked again.
        if last is None or (self._look.active and self._at == self._state.number):
            return
        trial, expected = last
        summary = summarised(trial)
        content = ""
        gain = float(self._gain.value or 1.0)
        named = evenly(len(summary.trails), _MOST_NAMED)
        for k, (name, xs, ys) in enumerate(summary.trails):
            content += trail(xs, ys, gain) + marked([(name if k in named else "", xs[0], ys[0])], "seen")
        box = ui.element("div").classes("frame-box trial").props('tabindex="0" role="region"')
        box.props["aria-label"] = "Paths of the markers; plus and minus zoom, arrow keys scroll"
        with box, ui.element("div").classes("frame-canvas"):
            image = ui.interactive_image(
                f"/frame/{self._state.number}/{int(trial.tracks.frame[0])}.png", content=content
            )
            image.classes("frame-image")
        for sentence in summary.advice:
            remark(Rank.DOUBTFUL, sentence)
        table(_COLUMNS, [row.as_text() for row in summary.rows])
        _windows(trial.windows)
        _expected(expected)
        for sentence in trial.tracks.notes:
            remark(Rank.NOTE, sentence)


def _windows(windows: tuple[FollowedWindow, ...]) -> None:
    if not windows:
        return
    heading("What is followed", 3)
    ui.label(
        "Each window follows its marker: the mean of its frames, and beside it how far they differ from the mean. "
        "Bright areas do not move with the marker, turn, or change their brightness."
    )
    with ui.row().classes("windows"):
        for window in windows:
            with ui.element("figure"):
                for png, what in ((window.mean_png, "mean"), (window.residual_png, "difference")):
                    picture = ui.element("img")
                    picture.props["src"] = f"data:image/png;base64,{b64encode(png).decode()}"
                    picture.props["alt"] = f"{what} of the window of {window.name}"
                with ui.element("figcaption"):
                    ui.label(f"{window.name}: {100.0 * window.unexplained:.0f} % unexplained")


def _expected(found: ExpectedIntervals | Failure | None) -> None:
    if found is None:
        ui.label("Predicting the intervals of a run")
        return
    heading("This would give", 3)
    if isinstance(found, Failure):
        ui.label(f"No prediction: {shown(found.reason)}.")
        return
    ui.label(
        f"90 % intervals of a free decay that begins with this motion, {found.amplitude_px:.3g} px at "
        f"{found.frequency_hz:.4g} Hz, and lasts to the end of the record, {found.seconds:.3g} s, for some damping "
        "ratios. They include the errors of the codec and of the template. Other modes, and damping that depends on "
        "the amplitude, widen them."
    )
    rows = [
        (
            f"{100.0 * row.damping_ratio:g}",
            f"± {row.frequency_hz:.2g}",
            f"± {100.0 * row.damping / row.damping_ratio:.2g}",
        )
        for row in found.rows
    ]
    table(_EXPECTED_COLUMNS, rows)

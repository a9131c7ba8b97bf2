"""Test track: some frames, or all, tracked at once: trails, standard deviations, what to change."""

from __future__ import annotations

import time
from base64 import b64encode
from typing import TYPE_CHECKING

from nicegui import ui

from modalcam.names import shown
from modalcam.studio.decoding import Problem
from modalcam.studio.overlay import marked, trail
from modalcam.studio.trial_summary import MOST_LISTED, summarised
from modalcam.studio.trial_windows import FollowedWindow, evenly
from modalcam.studio.views.shared import PageState, heading, in_thread, table
from tracker import FailedTracking

if TYPE_CHECKING:
    from modalcam.studio.expected import ExpectedIntervals

_LENGTHS = {64: "64 frames", 128: "128 frames", 300: "300 frames", 10**9: "all frames"}
_TICK_S = 0.5
# Names drawn in the picture: those of the stations of a line would lie over each other.
_MOST_NAMED = 8
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
        self._began_s = 0.0
        self._look = ui.timer(_TICK_S, self._tell, active=False)
        heading("Test track")
        ui.label(
            "Tracks some frames with the markers as they are now, saved or not. A decay that begins later is seen "
            "from a later frame on."
        )
        with ui.row().classes("frames"):
            self._length = (
                ui.select(_LENGTHS, value=128, label="Length").props("outlined dense").classes("number")
            )
            self._first = ui.number("From frame", value=0, min=0, step=1, format="%d")
            self._first.props("outlined dense").classes("number")
            self._button = ui.button("Track", on_click=self._track)
            self._gain = ui.number(
                "Motion enlarged", value=10, min=1, max=1000, on_change=self._result.refresh
            )
            self._gain.props("outlined dense").classes("number")
        self._status = ui.label("").props('role="status"').classes("status")
        self._result()
        state.when_recording_changes(self._clear)
        self._clear()

    def _clear(self) -> None:
        self._status.text = shown(self._state.file)
        self._result.refresh()

    def _tell(self) -> None:
        frames = self._state.studio.frames_tracked()
        what = f"{frames} frames tracked" if frames else "learning the markers"
        self._status.text = f"{shown(self._state.file)}: {what}, {time.monotonic() - self._began_s:.0f} s"

    async def _track(self) -> None:
        self._button.disable()
        number, self._began_s = self._state.number, time.monotonic()
        self._look.activate()
        self._result.refresh()
        first = max(int(self._first.value or 0), 0)
        trial = await in_thread(self._state.studio.track_some, number, self._length.value, first)
        self._look.deactivate()
        self._button.enable()
        if number != self._state.number:
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
        await in_thread(self._state.studio.expect, number)
        if number == self._state.number:
            self._result.refresh()

    @ui.refreshable_method
    def _result(self) -> None:
        last = self._state.studio.trial(self._state.number)
        # Of other markers, perhaps, while it is tracked again.
        if last is None or self._look.active:
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
            ui.label(sentence).classes("advice")
        table(_COLUMNS, [row.as_text() for row in summary.rows])
        _windows(trial.windows)
        _expected(expected)
        for sentence in trial.tracks.notes:
            ui.label(shown(sentence))


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


def _expected(found: ExpectedIntervals | Problem | None) -> None:
    if found is None:
        ui.label("Predicting the intervals of a run")
        return
    heading("This would give", 3)
    if isinstance(found, Problem):
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

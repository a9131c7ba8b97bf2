"""Test track: the first frames tracked at once, with the trails, the standard deviations and what to change."""

from __future__ import annotations

from nicegui import ui

from modalcam.names import shown
from modalcam.studio.overlay import marked, trail
from modalcam.studio.trial_summary import TrialSummary, summarised
from modalcam.studio.views.shared import PageState, heading, in_thread
from tracker.results import FailedTracking, MarkerTracks

_LENGTHS = {64: "64 frames", 128: "128 frames", 300: "300 frames"}
_COLUMNS = ("marker", "sd / px", "sd / mm", "largest motion / px", "largest step / px", "lost / %")


class TrialView:
    """Button, picture and table."""

    def __init__(self, state: PageState) -> None:
        self._state = state
        self._tracks: MarkerTracks | FailedTracking | None = None
        heading("Test track")
        ui.label("Tracks the first frames with the markers as they are now, saved or not.")
        with ui.row().classes("frames"):
            self._length = (
                ui.select(_LENGTHS, value=128, label="Length").props("outlined dense").classes("number")
            )
            self._button = ui.button("Track", on_click=self._track)
            self._gain = ui.number(
                "Motion enlarged", value=10, min=1, max=1000, on_change=self._result.refresh
            )
            self._gain.props("outlined dense").classes("number")
        self._status = ui.label("").props('role="status"').classes("status")
        self._result()
        state.when_recording_changes(self._clear)

    def _clear(self) -> None:
        self._tracks = None
        self._status.text = ""
        self._result.refresh()

    async def _track(self) -> None:
        self._button.disable()
        self._status.text = "tracking"
        number = self._state.number
        tracks = await in_thread(self._state.studio.track_first, number, self._length.value)
        self._button.enable()
        if number == self._state.number:
            self._tracks = tracks
            self._status.text = (
                f"{tracks.x_px.shape[0]} frames of {shown(self._state.file)}, {len(tracks.markers)} markers"
                if isinstance(tracks, MarkerTracks)
                else shown(tracks.reason)
            )
            self._result.refresh()

    @ui.refreshable_method
    def _result(self) -> None:
        if not isinstance(self._tracks, MarkerTracks):
            return
        summary = summarised(self._tracks)
        content = ""
        gain = float(self._gain.value or 1.0)
        for name, xs, ys in summary.trails:
            content += trail(xs, ys, gain) + marked([(name, xs[0], ys[0])], "seen")
        with ui.element("div").classes("frame-box trial"), ui.element("div").classes("frame-canvas"):
            image = ui.interactive_image(f"/frame/{self._state.number}/0.png", content=content)
            image.classes("frame-image")
        _table(summary)
        for sentence in summary.advice:
            ui.label(sentence).classes("advice")
        for sentence in self._tracks.notes:
            ui.label(shown(sentence))


def _table(summary: TrialSummary) -> None:
    with ui.element("div").classes("scrolled"), ui.element("table").classes("list"):
        with ui.element("thead"), ui.element("tr"):
            for name in _COLUMNS:
                with ui.element("th").props('scope="col"'):
                    ui.label(name)
        with ui.element("tbody"):
            for row in summary.rows:
                with ui.element("tr"):
                    for text in row.as_text():
                        with ui.element("td"):
                            ui.label(text)

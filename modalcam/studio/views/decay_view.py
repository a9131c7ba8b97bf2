"""Decay: displacement and spectrum of a test track or of the last run, the part that is used, and the modes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from modalcam.names import shown
from modalcam.studio.decay import Decay
from modalcam.studio.decoding import Problem
from modalcam.studio.views.charts import chart, curve_options, spectrum_options
from modalcam.studio.views.mode_choice import ModeChoice
from modalcam.studio.views.shared import PageState, heading, in_thread

# What a click on the chart of this id sends: the frequency under it, where it is on the axes.
_FREQUENCY_OF_CLICK = """(event) => {
    const chart = getElement(%d).chart, at = [event.offsetX, event.offsetY];
    if (chart.containPixel("grid", at)) emit(chart.convertFromPixel({xAxisIndex: 0}, at[0]));
}"""


class DecayView:
    """Charts, the slider of the part that is used, and the table of modes."""

    def __init__(self, state: PageState) -> None:
        self._state = state
        self._decay: Decay | None = None
        self._modes: ModeChoice
        self._channel: str | None = None
        self._run = state.studio.runner.state
        self._source: Callable[..., Decay | Problem] = state.studio.decay
        heading("Decay")
        ui.label(
            "What the last run found, or what the test track shows before a run. The part to be used is set by the "
            "band below the displacement: drag its ends, or the whole of it. The next run applies it."
        )
        with ui.row().classes("frames"):
            ui.button("Identify the test track", on_click=lambda: self._load(state.studio.decay_of_trial))
            ui.button("Show the last run", on_click=lambda: self._load(state.studio.decay))
        self._status = ui.label("").props('role="status"').classes("status")
        self._result()
        self._clear()
        state.when_recording_changes(self._clear)

    async def opened(self) -> None:
        """Show what there is of the recording, unless it is shown: the last run, or else the test track."""
        studio, number = self._state.studio, self._state.number
        if self._run is not studio.runner.state:
            self._decay, self._run = None, studio.runner.state
        if self._decay is None and studio.report() is not None:
            await self._load(studio.decay)
        elif self._decay is None and studio.trial(number) is not None:
            await self._load(studio.decay_of_trial)

    def _clear(self) -> None:
        self._decay, self._channel = None, None
        self._status.text = f"{shown(self._state.file)}: track its first frames, or run."
        self._result.refresh()

    async def _load(self, source: Callable[..., Decay | Problem]) -> None:
        number, self._source = self._state.number, source
        self._status.text = "working"
        found = await in_thread(source, number, self._channel)
        if number != self._state.number:
            return
        self._decay = None if isinstance(found, Problem) else found
        self._status.text = shown(found.reason) if isinstance(found, Problem) else shown(self._state.file)
        self._result.refresh()

    async def _choose(self, channel: str) -> None:
        if channel != self._channel:
            self._channel = channel
            await self._load(self._source)

    @ui.refreshable_method
    def _result(self) -> None:
        decay = self._decay
        if decay is None:
            return
        ui.select(
            list(decay.channels),
            label="Marker",
            value=decay.channel,
            on_change=lambda e: self._choose(e.value),
        ).props("outlined dense options-dense").classes("number")
        chart(curve_options(decay), "Displacement over time, with the parts of the record")
        self._part(decay)
        spectrum = chart(
            spectrum_options(decay), "Amplitude spectrum with the modes, and stabilisation of their poles"
        )
        spectrum.on(
            "click", lambda event: self._modes.pick(event.args), js_handler=_FREQUENCY_OF_CLICK % spectrum.id
        )
        self._modes = ModeChoice(self._state, decay, self._changed)
        for note in decay.notes:
            ui.label(shown(note))

    def _part(self, decay: Decay) -> None:
        recording = self._state.studio.draft.recording(self._state.file)
        first, last = decay.span_s
        start = first if recording.onset_s is None else recording.onset_s
        end = last if recording.end_s is None else recording.end_s
        step = max((last - first) / 1000.0, 1e-4)
        band = ui.range(min=first, max=last, step=step, value={"min": start, "max": end}).classes("band")
        band.props('drag-range aria-label="Part of the record that is used, in s"')
        with ui.row().classes("frames"):
            onset = ui.number("Start / s", value=start, step=0.01, format="%.4f").props("outlined dense")
            until = ui.number("End / s", value=end, step=0.01, format="%.4f").props("outlined dense")
            onset.classes("number")
            until.classes("number")
            # An end that was not moved is no limit: a test track ends before its recording.
            ui.button(
                "Use this part",
                on_click=lambda: self._use(
                    onset.value, until.value if (until.value or last) < last - step else None
                ),
            )
            ui.button("Detect the decay", on_click=lambda: self._use(None, None))

        def tell(low: float, high: float) -> None:
            # Quasar's range states its limits to a screen reader, but not where its ends are.
            band.props["aria-valuenow"] = low
            band.props["aria-valuetext"] = f"{low:.4g} to {high:.4g} s"

        def moved(event: Any) -> None:
            onset.value, until.value = event.value["min"], event.value["max"]
            tell(onset.value, until.value)

        tell(start, end)
        band.on_value_change(moved)

    async def _changed(self) -> None:
        """Identify a test track again with the options as they are; a run is what it was."""
        if self._source == self._state.studio.decay_of_trial:
            await self._load(self._source)
        else:
            ui.notify("Set; the next run applies it.")
            self._result.refresh()

    def _use(self, onset_s: float | None, end_s: float | None) -> None:
        draft, file = self._state.studio.draft, self._state.file
        values: dict[str, Any] = {
            "onset_s": None if onset_s is None else round(float(onset_s), 5),
            "end_s": None if end_s is None else round(float(end_s), 5),
        }
        if self._state.attempt(lambda: draft.set_for(file, values)):
            ui.notify(
                "Set; the next run applies it." if onset_s is not None else "The next run detects the decay."
            )

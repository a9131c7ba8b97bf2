"""Decay view: displacement and spectrum of a test track or of the last run, the part used, and choice of modes."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from nicegui import ui

from modalcam.apps.studio.decay import Decay, FoundMode, peak_near
from modalcam.apps.studio.draft import Draft
from modalcam.apps.studio.next_step import Rank
from modalcam.apps.studio.views.shared import (
    PageState,
    button,
    complain,
    heading,
    in_thread,
    number,
    remark,
    scrolled,
    table_head,
)
from modalcam.common import shown
from tracker import Failure

# Legible on light and on dark ground.
_INK, _CURVE, _MARK = "#808a93", "#0a8f6a", "#d0568f"
_MEASURED, _FITTED = "measured", "fit"
# Fill of a part of the record; its kind is written in it.
_FILLS = {"decay": "#0a8f6a26", "driven": "#e69f0026"}
_OTHER_FILL = "#80808040"
# Part of the record, as a share of it, from which on its name is shown.
_LEAST_NAMED = 0.08
_AXIS = {
    "nameLocation": "middle",
    "axisLine": {"lineStyle": {"color": _INK}},
    "axisLabel": {"color": _INK, "showMaxLabel": False},
    "splitLine": {"show": False},
}
_POLES = {True: "stable pole", False: "other pole"}


def chart(options: dict[str, Any], name: str) -> Any:
    """A chart with a name for a screen reader."""
    element = ui.echart(options).classes("chart").props('role="img"')
    element.props["aria-label"] = name
    return element


def _options(x_name: str, y_name: str, points: tuple[tuple[float, float], ...], scale: str) -> dict[str, Any]:
    return {
        "animation": False,
        "grid": {"left": 80, "right": 20, "top": 30, "bottom": 64},
        "xAxis": {
            "type": "value",
            "name": x_name,
            "nameGap": 28,
            "min": "dataMin",
            "max": "dataMax",
            **_AXIS,
        },
        "yAxis": {"type": scale, "name": y_name, "nameGap": 60, **_AXIS},
        # Whole again, where a chart shows something else than before.
        "dataZoom": [{"type": "inside", "start": 0, "end": 100}],
        "series": [_line(points, _CURVE)],
    }


def _line(points: tuple[tuple[float, float], ...], colour: str, name: str = "") -> dict[str, Any]:
    return {
        "type": "line",
        "name": name,
        "data": [list(point) for point in points],
        "showSymbol": False,
        "color": colour,
        "lineStyle": {"width": 1, "color": colour},
    }


def residual_options(decay: Decay) -> dict[str, Any]:
    """What the fit leaves of the displacement, on the time axis of the displacement."""
    options = _options("time / s", f"residual / {decay.unit}", decay.residual, "value")
    return options | {"xAxis": options["xAxis"] | {"min": decay.curve[0][0], "max": decay.curve[-1][0]}}


def curve_options(decay: Decay) -> dict[str, Any]:
    """Displacement over time and its fit, with the parts of the record."""
    options = _options("time / s", f"displacement / {decay.unit}", decay.curve, "value")
    options["series"][0]["name"] = _MEASURED
    options["series"].append(_line(decay.fit, _MARK, _FITTED))
    options["legend"] = {"bottom": 0, "right": 20, "textStyle": {"color": _INK}, "data": [_MEASURED, _FITTED]}
    # Names of short parts would lie over each other.
    least_s = _LEAST_NAMED * (decay.span_s[1] - decay.span_s[0])
    options["series"][0]["markArea"] = {
        "label": {"color": _INK},
        "data": [
            [
                {
                    "xAxis": start,
                    "name": kind if end - start > least_s else "",
                    "itemStyle": {"color": _FILLS.get(kind, _OTHER_FILL)},
                },
                {"xAxis": end},
            ]
            for kind, start, end in decay.parts
        ],
    }
    return options


def spectrum_options(decay: Decay) -> dict[str, Any]:
    """Spectrum with lines at the modes, and the poles of the stabilisation chart."""
    # A logarithmic axis has no zero.
    points = tuple((f, a) for f, a in decay.spectrum if a > 0.0)
    options = _options("frequency / Hz", f"amplitude / {decay.unit}", points, "log")
    options["series"][0]["markLine"] = {
        "symbol": "none",
        "lineStyle": {"color": _MARK, "type": "dashed"},
        "data": [
            {
                "xAxis": mode.frequency_hz,
                # Along the line: beside each other, the names of close modes would overlap.
                "label": {
                    "formatter": f"{mode.frequency_hz:.4g} Hz",
                    "color": _INK,
                    "position": "insideEndTop",
                },
            }
            for mode in decay.modes
        ],
    }
    if decay.poles:
        orders = {
            **_AXIS,
            "type": "value",
            "name": "model order",
            "nameGap": 30,
            "axisLabel": {"color": _INK},
        }
        options["yAxis"] = [options["yAxis"], orders | {"nameTextStyle": {"color": _INK}}]
        options["grid"]["right"] = 60
        options["legend"] = {
            "bottom": 0,
            "right": 60,
            "textStyle": {"color": _INK},
            "data": [*_POLES.values()],
        }
        options["series"] += [_poles(decay, is_stable=stable) for stable in (True, False)]
    return options


def _poles(decay: Decay, *, is_stable: bool) -> dict[str, Any]:
    return {
        "type": "scatter",
        "name": _POLES[is_stable],
        "yAxisIndex": 1,
        "symbol": "circle" if is_stable else "emptyCircle",
        "symbolSize": 6 if is_stable else 4,
        "itemStyle": {"color": _MARK if is_stable else _INK},
        "data": [[pole.frequency_hz, pole.order] for pole in decay.poles if pole.is_stable == is_stable],
    }


_COLUMNS = ("frequency / Hz", "damping ratio / %", "90 % interval / %", "flags", "role")
# Options that list frequencies: what is said of one of them, and what takes it out of the list.
_LISTS = {"add_hz": ("Added", "Remove"), "reject_hz": ("Rejected", "Accept")}


class ModeChoice:
    """Table of the modes, and a field for a frequency that is not in it; `changed` is called after each choice."""

    def __init__(self, state: PageState, decay: Decay, changed: Callable[[], Awaitable[None]]) -> None:
        self._state, self._decay, self._changed = state, decay, changed
        self._recording = state.recording
        with ui.row().classes("frames"):
            self._wanted_hz = number("Frequency of another mode / Hz", "wide-number", min=0, format="%.5g")
            ui.button("Fit a mode there", on_click=self._add)
            ui.button("Make it the target", on_click=lambda: self._target(self._wanted_hz.value))
            given = self._recording.target_frequency_hz
            ui.label("Click the chart, or type." + (f" Target now: {given:g} Hz." if given else ""))
        with scrolled(), ui.element("table").classes("list"):
            table_head(_COLUMNS)
            with ui.element("tbody"):
                for mode in decay.modes:
                    self._mode(mode)
        for key in _LISTS:
            self._listed(key)

    def pick(self, frequency_hz: float) -> None:
        """Take the highest point of the spectrum about a click."""
        self._wanted_hz.value = peak_near(self._decay.spectrum, frequency_hz)

    def _mode(self, mode: FoundMode) -> None:
        low, high = (100.0 * value for value in mode.interval)
        known = mode.damping_ratio == mode.damping_ratio
        texts = (
            f"{mode.frequency_hz:.4f}",
            f"{100.0 * mode.damping_ratio:.4f}" if known else "–",
            f"{low:.4f} to {high:.4f}" if known else "–",
            ", ".join(mode.flags),
        )
        with ui.element("tr"):
            for text in texts:
                with ui.element("td"):
                    ui.label(text)
            with ui.element("td"), ui.row().classes("actions"):
                if mode.target:
                    ui.label("target")
                else:
                    make = partial(self._target, mode.frequency_hz)
                    button("Make it the target", make, f"Make {mode.frequency_hz:.4g} Hz the target")
                if _rounded(mode.frequency_hz) in self._recording.reject_hz:
                    ui.label("rejected in the next run")
                else:
                    reject = partial(self._put, "reject_hz", mode.frequency_hz)
                    button("Reject", reject, f"Reject {mode.frequency_hz:.4g} Hz")

    def _listed(self, key: str) -> None:
        said, out = _LISTS[key]
        for frequency_hz in getattr(self._recording, key):
            with ui.row().classes("frames"):
                ui.label(f"{said}: {frequency_hz:g} Hz")
                button(out, partial(self._take_out, key, frequency_hz), f"{out} {frequency_hz:g} Hz")

    async def _add(self) -> None:
        if self._is_given(self._wanted_hz.value):
            await self._put("add_hz", self._wanted_hz.value)

    async def _put(self, key: str, frequency_hz: float) -> None:
        """Add a frequency to an option that lists them, unless it is in it."""
        own = _rounded(frequency_hz)
        await self._set({key: [*(f for f in getattr(self._recording, key) if f != own), own]})

    async def _take_out(self, key: str, frequency_hz: float) -> None:
        await self._set({key: [f for f in getattr(self._recording, key) if f != frequency_hz] or None})

    async def _target(self, frequency_hz: float | None) -> None:
        if self._is_given(frequency_hz):
            await self._set({"mode": None, "target_frequency_hz": _rounded(frequency_hz or 0.0)})

    async def _set(self, values: dict[str, Any]) -> None:
        if self._state.edit(Draft.set_for, values):
            await self._changed()

    def _is_given(self, frequency_hz: float | None) -> bool:
        if not frequency_hz:
            complain("expected a frequency in Hz: click the spectrum, or type one")
        return bool(frequency_hz)


def _rounded(frequency_hz: float) -> float:
    """A frequency as it is written into the configuration."""
    return float(f"{frequency_hz:.5g}")


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
        self._source: Callable[..., Decay | Failure] = state.studio.decay
        heading("Decay")
        ui.label(
            "What the last run found, or what the test track shows before a run. The part to be used is set by the "
            "band below the displacement: drag its ends, or the whole of it. The next run applies it."
        )
        with ui.row().classes("frames"):
            ui.button("Identify the test track", on_click=lambda: self._load(state.studio.decay_of_trial))
            ui.button("Show the last run", on_click=lambda: self._load(state.studio.decay))
        self._status = ui.label("").props('role="status"').classes("status")
        # The charts stay, and show other data: one that is removed before it is drawn raises an error in the browser.
        with ui.element("div").classes("full") as self._box:
            self._channels = ui.select([], label="Marker", on_change=lambda e: self._choose(e.value))
            self._channels.props("outlined dense options-dense").classes("number")
            self._curve = chart({}, "Displacement over time with the fit, and the parts of the record")
            self._part()
            self._residual = chart({}, "Residual of the fit over time")
            self._spectrum = chart({}, "Amplitude spectrum with the modes, and stabilisation of their poles")
            picked = _FREQUENCY_OF_CLICK % self._spectrum.id
            self._spectrum.on("click", lambda event: self._modes.pick(event.args), js_handler=picked)
            self._result()
        self._clear()
        state.when_recording_changes(self._clear)

    async def opened(self) -> None:
        """Show what there is of the recording, unless it is shown: the last run, or else the test track."""
        studio = self._state.studio
        if self._run is not studio.runner.state:
            self._decay, self._run = None, studio.runner.state
        if self._decay is None and studio.report() is not None:
            await self._load(studio.decay)
        elif self._decay is None and studio.trial(self._state.number) is not None:
            await self._load(studio.decay_of_trial)

    def _clear(self) -> None:
        self._decay, self._channel = None, None
        self._status.text = f"{shown(self._state.file)}: track its first frames, or run."
        self._show()

    async def _load(self, source: Callable[..., Decay | Failure]) -> None:
        at, self._source = self._state.number, source
        self._status.text = "working"
        found = await in_thread(source, at, self._channel)
        if at != self._state.number:
            return
        self._decay = None if isinstance(found, Failure) else found
        self._status.text = shown(found.reason) if isinstance(found, Failure) else shown(self._state.file)
        self._show()

    async def _choose(self, channel: str) -> None:
        if self._decay is not None and channel != self._decay.channel:
            self._channel = channel
            await self._load(self._source)

    def _show(self) -> None:
        decay = self._decay
        self._box.visible = decay is not None
        if decay is not None:
            self._state.studio.decay_seen = True
            self._channels.set_options(list(decay.channels), value=decay.channel)
            self._residual.visible = bool(decay.residual)
            for one, options in (
                (self._curve, curve_options(decay)),
                (self._residual, residual_options(decay)),
                (self._spectrum, spectrum_options(decay)),
            ):
                one.options.clear()
                one.options.update(options)
                one.update()
            self._show_part(decay)
        self._result.refresh()

    @ui.refreshable_method
    def _result(self) -> None:
        if self._decay is not None:
            self._modes = ModeChoice(self._state, self._decay, self._changed)
            for note in self._decay.doubts:
                remark(Rank.DOUBTFUL, note)
            for note in self._decay.notes:
                remark(Rank.NOTE, note)

    def _part(self) -> None:
        """The slider of the part that is used, and its ends as numbers."""
        self._band = ui.range(min=0.0, max=1.0, value={"min": 0.0, "max": 1.0}).classes("band")
        self._band.props('drag-range aria-label="Part of the record that is used, in s"')
        with ui.row().classes("frames"):
            self._onset = number("Start / s", step=0.01, format="%.4f")
            self._until = number("End / s", step=0.01, format="%.4f")
            ui.button("Use this part", on_click=self._use_part)
            ui.button("Detect the decay", on_click=lambda: self._use(None, None))
        self._band.on_value_change(lambda event: self._moved(**event.value))

    def _show_part(self, decay: Decay) -> None:
        """The part given, or else the one that was fitted."""
        recording, (first, last) = self._state.recording, decay.span_s
        start, end = decay.fitted_s or decay.span_s
        self._ends = (
            start if recording.onset_s is None else recording.onset_s,
            end if recording.end_s is None else recording.end_s,
        )
        self._band.props.update({"min": first, "max": last, "step": max((last - first) / 1000.0, 1e-4)})
        self._band.set_value({"min": self._ends[0], "max": self._ends[1]})
        self._moved(*self._ends)

    def _moved(self, min: float, max: float) -> None:  # noqa: A002 - the names of the range's ends
        self._onset.value, self._until.value = min, max
        # Quasar's range states its limits to a screen reader, but not where its ends are.
        self._band.props["aria-valuenow"] = min
        self._band.props["aria-valuetext"] = f"{min:.4g} to {max:.4g} s"

    def _use_part(self) -> None:
        until, step = self._until.value, self._band.props["step"]
        is_moved = until is not None and abs(until - self._ends[1]) > step
        is_limit = self._state.recording.end_s is not None or is_moved
        # An end that was not moved is no limit: a test track ends before its recording.
        at_end = until is None or until >= self._band.props["max"] - step
        self._use(self._onset.value, None if at_end or not is_limit else until)

    async def _changed(self) -> None:
        """Identify a test track again with the options as they are; a run is what it was."""
        if self._source == self._state.studio.decay_of_trial:
            await self._load(self._source)
        else:
            ui.notify("Set; the next run applies it.")
            self._result.refresh()

    def _use(self, onset_s: float | None, end_s: float | None) -> None:
        values = {
            "onset_s": None if onset_s is None else round(float(onset_s), 5),
            "end_s": None if end_s is None else round(float(end_s), 5),
        }
        if self._state.edit(Draft.set_for, values):
            ui.notify(
                "Set; the next run applies it." if onset_s is not None else "The next run detects the decay."
            )

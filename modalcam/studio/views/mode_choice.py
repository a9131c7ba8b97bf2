"""The modes of a recording: which is the target, which are none, and which are fitted below the noise threshold."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from modalcam.studio.decay import Decay, FoundMode, peak_near
from modalcam.studio.views.shared import PageState, complain, scrolled, table_head

_COLUMNS = ("frequency / Hz", "damping ratio / %", "90 % interval / %", "flags", "role")
# Options that list frequencies: what is said of one of them, and what takes it out of the list.
_LISTS = {"add_hz": ("Added", "Remove"), "reject_hz": ("Rejected", "Accept")}


class ModeChoice:
    """Table of the modes, and a field for a frequency that is not in it; `changed` is called after each choice."""

    def __init__(self, state: PageState, decay: Decay, changed: Callable[[], Awaitable[None]]) -> None:
        self._state, self._decay, self._changed = state, decay, changed
        self._recording = state.studio.draft.recording(state.file)
        with ui.row().classes("frames"):
            self._wanted_hz: Any = ui.number("Frequency of another mode / Hz", min=0, format="%.5g")
            self._wanted_hz.props("outlined dense").classes("wide-number")
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
                    button = ui.button("Make it the target", on_click=lambda: self._target(mode.frequency_hz))
                    button.props["aria-label"] = f"Make {mode.frequency_hz:.4g} Hz the target"
                if _rounded(mode.frequency_hz) in self._recording.reject_hz:
                    ui.label("rejected in the next run")
                else:
                    button = ui.button("Reject", on_click=lambda: self._put("reject_hz", mode.frequency_hz))
                    button.props["aria-label"] = f"Reject {mode.frequency_hz:.4g} Hz"

    def _listed(self, key: str) -> None:
        said, out = _LISTS[key]
        for frequency_hz in getattr(self._recording, key):
            with ui.row().classes("frames"):
                ui.label(f"{said}: {frequency_hz:g} Hz")
                button = ui.button(out, on_click=lambda f=frequency_hz: self._take_out(key, f))
                button.props["aria-label"] = f"{out} {frequency_hz:g} Hz"

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
        draft, file = self._state.studio.draft, self._state.file
        if self._state.attempt(lambda: draft.set_for(file, values)):
            await self._changed()

    def _is_given(self, frequency_hz: float | None) -> bool:
        if not frequency_hz:
            complain("expected a frequency in Hz: click the spectrum, or type one")
        return bool(frequency_hz)


def _rounded(frequency_hz: float) -> float:
    """A frequency as it is written into the configuration."""
    return float(f"{frequency_hz:.5g}")

"""List of the recordings: what they are, at what rate they were recorded, and their problems."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import ui

from modalcam.apps.studio.draft import Value
from modalcam.apps.studio.frames import markers_text
from modalcam.apps.studio.markers import parse_rate
from modalcam.apps.studio.next_step import Rank
from modalcam.apps.studio.views.shared import (
    PageState,
    button,
    heading,
    in_thread,
    remark,
    scrolled,
    table_head,
)
from modalcam.apps.studio.views.shared import number as number_field
from modalcam.common import shown
from modalcam.config import REQUIRED_OF_BEAM, BeamConfig, option
from modalcam.inputs import RATE_UNKNOWN, Probe

RATE_WARNING = (
    "The recorded rate is not the playback rate. A high-speed video stored with 30 fps may contain frames recorded at "
    "1000 fps; every frequency is then wrong by a factor of 33. Give the rate at which the scene was recorded."
)
_TYPE_RATE = f"{RATE_UNKNOWN}: type it in this row, or above for all recordings"
_COLUMNS = (
    "first frame",
    "recording",
    "size / px",
    "frames",
    "rate in the file",
    "recorded rate / fps",
    "mode",
    "in the run",
    "markers",
)
# Recordings on one page of the list.
_PER_PAGE = 50


class RecordingsView:
    """The list, filled in when the recordings have been read."""

    def __init__(self, state: PageState, show_frame: Callable[[], None]) -> None:
        self._state = state
        self._show_frame = show_frame
        self._probes: tuple[Probe, ...] = ()
        self._page = 1
        self._rates: dict[int, Any] = {}
        self._modes: dict[int, Any] = {}
        self._notes: dict[int, Any] = {}
        self._markers: dict[int, Any] = {}
        self._included: dict[int, Any] = {}
        self._facts: dict[int, tuple[Any, ...]] = {}
        heading(f"Recordings of {shown(state.studio.folder.name)}")
        self._rate_box()
        self._list()
        state.when_draft_changes(self._update)
        ui.timer(0.1, self._read, once=True)

    async def _read(self) -> None:
        self._probes = await in_thread(self._state.studio.probes)
        self._update()

    def _rate_box(self) -> None:
        draft = self._state.studio.draft
        with ui.card().classes("notice").props('role="note"'):
            ui.label(RATE_WARNING)
            with ui.row():
                rate = (
                    ui.input("Recorded rate of all recordings / fps").classes("rate").props("outlined dense")
                )
                clock = number_field("Tolerance of the clock / ppm", "rate", min=0)
            rate.on("change", lambda: self._set_for_all("fps", parse_rate(rate.value)))
            clock.on("change", lambda: self._set_for_all("fps_tolerance_ppm", clock.value))
            with clock:
                ui.tooltip(option("camera.fps_tolerance_ppm").help)

        def refresh() -> None:
            camera = draft.config.camera
            rate.value = "" if camera.fps is None else _rate_text(camera.fps)
            clock.value = camera.fps_tolerance_ppm

        refresh()
        self._state.when_draft_changes(refresh)

    def _set_for_all(self, key: str, value: Value | None) -> None:
        draft = self._state.studio.draft
        self._state.attempt(lambda: draft.set_section("camera", {key: value}))

    @ui.refreshable_method
    def _list(self) -> None:
        self._rates, self._modes, self._notes, self._markers = {}, {}, {}, {}
        self._facts, self._included = {}, {}
        recordings = self._state.studio.recordings
        first = (self._page - 1) * _PER_PAGE
        with scrolled(), ui.element("table").classes("list"):
            table_head(_COLUMNS)
            with ui.element("tbody"):
                for number in range(first, min(first + _PER_PAGE, len(recordings))):
                    self._row(number)
        if len(recordings) > _PER_PAGE:
            pages = -(-len(recordings) // _PER_PAGE)
            ui.pagination(1, pages, value=self._page, on_change=lambda event: self._turn(event.value))
        for note in self._state.studio.notes:
            ui.label(note)

    def _turn(self, page: int) -> None:
        self._page = page
        self._list.refresh()

    def _row(self, number: int) -> None:
        found = self._state.studio.recordings[number]
        name = shown(found.file)
        with ui.element("tr").classes("facts"):
            with ui.element("td"):
                picture = ui.element("img").classes("thumbnail").props('loading="lazy" width="160"')
                picture.props["src"] = f"/thumbnail/{number}.png"
                picture.props["alt"] = f"First frame of {name}, turned by 90° if it is higher than wide"
            with ui.element("th").props('scope="row"'):
                ui.label(name)
            self._facts[number] = tuple(_cell() for _ in range(3))
            with ui.element("td"):
                self._rate(number)
            with ui.element("td"):
                self._mode(number)
            with ui.element("td"):
                self._include(number)
            with ui.element("td"), ui.row().classes("actions"):
                self._markers[number] = ui.label("")
                open_it = button("Set markers", lambda: self._open(number), f"Set markers of {name}")
                open_it.props("no-caps no-wrap")
        with ui.element("tr").classes("notes"), ui.element("td").props(f"colspan={len(_COLUMNS)}"):
            self._notes[number] = ui.element("div")
        self._update_row(number)

    def _rate(self, number: int) -> None:
        state = self._state
        file = state.studio.recordings[number].file
        box = ui.input().props("outlined dense").classes("rate")
        box.props["aria-label"] = f"Recorded rate of {shown(file)} in frames per second"

        def change() -> None:
            if box.value != self._given(number):
                state.attempt(lambda: state.studio.draft.set_for(file, {"fps": parse_rate(box.value)}))

        box.on("change", change)
        self._rates[number] = box

    def _mode(self, place: int) -> None:
        state, file = self._state, self._state.studio.recordings[place].file
        box = number_field("", "mode", min=1, step=1, format="%d")
        box.props["aria-label"] = f"Number of the mode of {shown(file)}"
        with box:
            ui.tooltip(option("recordings.mode").help)

        def change() -> None:
            given = None if box.value is None else int(box.value)
            # The configuration takes either.
            other = {} if given is None else {"target_frequency_hz": None}
            if given != state.studio.draft.recording(file).mode:
                state.attempt(lambda: state.studio.draft.set_for(file, {"mode": given, **other}))

        box.on("change", change)
        self._modes[place] = box

    def _include(self, number: int) -> None:
        state = self._state
        file = state.studio.recordings[number].file

        def change(event: Any) -> None:
            if event.value == state.studio.draft.recording(file).leave_out:
                wanted = None if event.value else True
                state.attempt(lambda: state.studio.draft.set_for(file, {"leave_out": wanted}))

        box = ui.checkbox(value=True, on_change=change)
        box.props["aria-label"] = f"Include {shown(file)} in the run"
        self._included[number] = box

    def _given(self, number: int) -> str:
        studio = self._state.studio
        given = studio.draft.recording(studio.recordings[number].file).fps
        return "" if given is None else _rate_text(given)

    def _update(self) -> None:
        # In place: a row that was built anew would lose the focus, and a click on it.
        for number in self._rates:
            self._update_row(number)

    def _update_row(self, number: int) -> None:
        given = self._given(number)
        self._rates[number].value = given
        studio = self._state.studio
        recording = studio.draft.recording(studio.recordings[number].file)
        self._markers[number].text = markers_text(recording)
        self._included[number].value = not recording.leave_out
        self._modes[number].value = recording.mode
        probe = self._probes[number] if self._probes else None
        for label, text in zip(self._facts[number], _facts(probe), strict=True):
            label.text = shown(text)
        known = None if probe is None else probe.fps_recorded
        self._rates[number].props["placeholder"] = (
            "unknown" if known is None else f"{known:g} (camera header)"
        )
        if probe is not None:
            notes = [n for n in probe.notes if not n.startswith(RATE_UNKNOWN)]
            unknown = _TYPE_RATE if len(notes) < len(probe.notes) and not given else ""
            self._notes[number].clear()
            with self._notes[number]:
                for rank, texts in zip(Rank, ([probe.problem], [unknown], notes), strict=True):
                    for text in filter(None, texts):
                        remark(rank, text)

    def _open(self, number: int) -> None:
        self._state.choose(number)
        self._show_frame()


def _facts(probe: Probe | None) -> tuple[str, str, str]:
    if probe is None:
        return "reading", "", ""
    rate = "" if probe.fps_container is None else f"{probe.fps_container:g}"
    return probe.size_px, str(probe.packets or ""), rate


def _cell() -> Any:
    with ui.element("td"):
        return ui.label("")


def _rate_text(rate: Any) -> str:
    return f"{float(rate):g}" if float(f"{float(rate):g}") == rate else str(rate)


_CHOICES = ("orientation", "material")


class BeamView:
    """Fields of ``[beam]``; their texts and units are those of the configuration."""

    def __init__(self, state: PageState) -> None:
        self._state = state
        heading("Beam")
        ui.label(
            "With its beam, a run numbers the modes, updates the beam and compares models of damping. For this it also "
            "needs the distances of the markers from the clamp, given under Markers."
        )
        self._status = ui.label("").props('role="status"').classes("status")
        with ui.element("div").classes("form"):
            self._fields = {key: self._field(key) for key in (*REQUIRED_OF_BEAM, *_CHOICES, "angle_deg")}
        self._remove = ui.button("Remove the beam", on_click=lambda: self._write(None))
        state.when_draft_changes(self._update)
        self._update()

    def _field(self, key: str) -> Any:
        known = option(f"beam.{key}")
        end = known.unit.lower().replace("/", "_").replace("³", "3").replace("°", "deg")
        unit = f"({known.unit})" if "/" in known.unit else known.unit
        name = key.removesuffix(f"_{end}").replace("_", " ").capitalize()
        label, take = " / ".join(filter(None, (name, unit))), partial(self._take, key)
        if key in _CHOICES:
            field: Any = ui.select(
                ["", *known.type.replace('"', "").split(", ")], label=label, on_change=take
            )
        else:
            field = ui.number(label).on("change", take)
        field.props("outlined dense options-dense hide-bottom-space")
        field.props["hint"] = known.field.description if key in _CHOICES else known.help
        return field

    def _take(self, key: str) -> None:
        values = {name: None if field.value == "" else field.value for name, field in self._fields.items()}
        is_angled = values["orientation"] == "angled"
        # The configuration takes an angle with this orientation only, and not the one without the other.
        self._fields["angle_deg"].visible = is_angled
        changed = {key: values[key]}
        if key in ("orientation", "angle_deg"):
            changed = {
                "orientation": values["orientation"],
                "angle_deg": values["angle_deg"] if is_angled else None,
            }
        if is_angled and values["angle_deg"] is None:
            self._status.text = "Give the angle: the orientation is written with it."
            return
        given = self._state.studio.draft.config.beam or BeamConfig()
        changed = {name: value for name, value in changed.items() if value != getattr(given, name)}
        if changed:
            self._write(changed)

    def _write(self, values: dict[str, Any] | None) -> None:
        self._state.attempt(lambda: self._state.studio.draft.set_section("beam", values))

    def _update(self) -> None:
        beam = self._state.studio.draft.config.beam
        for key, field in self._fields.items():
            value = getattr(beam or BeamConfig(), key)
            field.value = "" if value is None and key in _CHOICES else value
        self._fields["angle_deg"].visible = self._fields["orientation"].value == "angled"
        self._remove.visible = beam is not None
        missing = () if beam is None else beam.missing()
        self._status.text = (
            "Without a beam nothing is simulated."
            if beam is None
            else f"Nothing is simulated without {', '.join(missing)}."
            if missing
            else "The beam is complete."
        )

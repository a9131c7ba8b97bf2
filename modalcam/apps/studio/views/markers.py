"""Markers of a recording: their options as a form, and what was found in the frames, to name, accept or leave out.

Everything that a click sets can be read and typed in the form.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import ui

from modalcam.apps.studio import markers as markers_edit
from modalcam.apps.studio.draft import Draft, section_of
from modalcam.apps.studio.frames import Point, drawn_line, marked, patch_names
from modalcam.apps.studio.session import options_error
from modalcam.apps.studio.views.shared import PageState, button, heading, in_thread, number
from modalcam.common import shown
from modalcam.config import RecordingConfig, option
from tracker import Failure
from tracker.markers import AUTO, MARKER_KINDS, kind_of

if TYPE_CHECKING:
    from modalcam.apps.studio.trial import DetectedMarker

_SIDES = ("top", "bottom", "left", "right")
_CHOICES = ("kind", "patch_shape", "clamp_side")
# Numbers of the form, with the text beside each.
_NUMBERS = {
    "size_px": "Size of the window / px",
    "size_mm": "Size of a marker / mm",
    "mm_per_px": "Scale / (mm/px)",
    "exposure_s": "Exposure time / s",
    "target_frequency_hz": "Expected frequency / Hz",
}


_EXCITATIONS = {"free": "Released: it decays, or the clamp moves", "ambient": "Wind, traffic: not measured"}


class MarkerForm:
    """Fields of one recording, which follow the draft.

    They are changed in place: a field that was built anew would lose the focus of the keyboard.
    """

    def __init__(self, state: PageState) -> None:
        self._state = state
        self._values: dict[str, Any] = {}
        self._boxes: list[tuple[Any, ...]] = []
        self._had_positions = False
        heading("Markers", 3)
        self._problem = ui.label("").classes("problem").props('role="alert"')
        self._choice("Kind", "kind", [AUTO, *MARKER_KINDS])
        self._patches = ui.column().classes("full")
        with self._patches:
            self._choice("Window", "patch_shape", ["square", "round"])
            self._points = ui.column().classes("full")
        self._line = ui.row().classes("frames")
        with self._line:
            self._ends = ui.label("")
            ui.button("Swap its ends", on_click=self._swap_ends)
            ui.button("Remove the line", on_click=lambda: self._set(line_px=None, kind=None))
        self._positions_field()
        self._regions()
        self._choice("Clamped at the", "clamp_side", ["", *_SIDES])
        self._choice("What drives the beam", "excitation", _EXCITATIONS)
        self._input = ui.input("Markers on the clamp, where it moves").props("outlined dense").classes("full")
        self._input.on("change", self._take_input)
        for key, label in _NUMBERS.items():
            self._number(key, label)
        state.when_draft_changes(self._update)
        state.when_recording_changes(self._update)
        self._update()

    def _set(self, **values: Any) -> None:
        recording = self._state.recording
        changed = {key: value for key, value in values.items() if value != getattr(recording, key)}
        if changed:
            self._state.edit(Draft.set_for, changed)

    def _update(self) -> None:
        recording = self._state.recording
        for key, field in self._values.items():
            value = getattr(recording, key)
            field.value = ("" if value is None else value) if key in _CHOICES else value
        self._position.value = _positions_text(recording.positions_mm)
        self._input.value = " ".join(recording.input)
        kind = kind_of(recording.kind)
        self._patches.visible = not kind.is_sought or (bool(recording.points_px) and not kind.follows_line)
        self._show_points(recording)
        self._line.visible = kind.follows_line and recording.line_px is not None
        if recording.line_px is not None:
            (x0, y0), (x1, y1) = recording.line_px
            self._ends.text = f"Line from the clamp at ({x0:g}, {y0:g}) to the free end at ({x1:g}, {y1:g})"
        self._regions.refresh()
        self._problem.text = options_error(self._state.studio.draft, self._state.file)

    def _positions_field(self) -> None:
        self._position = ui.input("Distances from the clamp / mm").props("outlined dense").classes("full")
        self._position.on(
            "change", lambda: self._state.edit(markers_edit.set_positions, self._position.value)
        )

    def _take_input(self) -> None:
        names = (self._input.value or "").replace(",", " ").split()
        if tuple(names) != self._state.recording.input:
            self._state.edit(Draft.set_for, {"input": names or None})

    def _swap_ends(self) -> None:
        clamp, free_end = self._state.recording.line_px or ()
        self._state.edit(markers_edit.set_line, free_end, clamp)

    @ui.refreshable_method
    def _regions(self) -> None:
        for k, (corner, opposite) in enumerate(self._state.recording.leave_out_px):
            where = f"({corner[0]:g}, {corner[1]:g}) to ({opposite[0]:g}, {opposite[1]:g})"
            with ui.row().classes("frames"):
                ui.label(f"Left out: {where}")
                delete = partial(self._state.edit, markers_edit.delete_region, k)
                button("Delete", delete, f"Delete the region from {where}")

    def _choice(self, label: str, key: str, options: list[str] | dict[str, str]) -> None:
        field = ui.select(options, label=label, value=next(iter(options))).props(
            "outlined dense options-dense"
        )
        field.classes("full").on_value_change(lambda event: self._set(**{key: event.value or None}))
        self._values[key] = field

    def _number(self, key: str, label: str) -> None:
        field = number(label, "full", min=0)
        with field:
            ui.tooltip(_help(key))
        field.on("change", lambda: self._set(**{key: field.value}))
        self._values[key] = field

    def _show_points(self, recording: RecordingConfig) -> None:
        points, positions = recording.points_px or (), recording.positions_mm or ()
        if len(points) != len(self._boxes):
            self._boxes = []
            self._points.clear()
            with self._points:
                for k in range(len(points)):
                    self._point(k)
        # Distances of only some of the markers are typed, but not in the configuration yet.
        complete = positions if len(positions) == len(points) else None
        for k, (boxes, name, at) in enumerate(zip(self._boxes, patch_names(recording), points, strict=True)):
            for box, value in zip(boxes, (name, *at), strict=False):
                box.value = value
            if complete is not None or self._had_positions:
                boxes[3].value = None if complete is None else complete[k]
        self._had_positions = complete is not None

    def _point(self, k: int) -> None:
        place = f"m{k + 1}"
        with ui.row().classes("frames point"):
            name = ui.input("name").props("outlined dense").classes("number")
            name.props["aria-label"] = f"Name of {place}"
            name.on("change", lambda: self._rename(k))
            boxes = tuple(number(label, step=1) for label in ("x / px", "y / px", "mm"))
            boxes[2].props["aria-label"] = f"Distance of {place} from the clamp in mm"
            for box in boxes[:2]:
                box.on("change", lambda: self._move(k))
            boxes[2].on("change", self._take_positions)
            if k:
                button(
                    "↑", partial(self._state.edit, markers_edit.move_earlier, k), f"Move {place} before m{k}"
                )
            button("✕", partial(self._state.edit, markers_edit.delete_point, k), f"Delete {place}")
        self._boxes.append((name, *boxes))

    def _rename(self, k: int) -> None:
        self._state.edit(markers_edit.rename_point, k, self._boxes[k][0].value or "")

    def _move(self, k: int) -> None:
        _, x, y, _ = self._boxes[k]
        self._state.edit(markers_edit.move_point, k, (float(x.value or 0.0), float(y.value or 0.0)))

    def _take_positions(self) -> None:
        """Write the distances once every marker has one, or none."""
        given = [boxes[3].value for boxes in self._boxes]
        typed = [str(value) for value in given if value is not None]
        if len(typed) in (0, len(given)):
            self._state.edit(markers_edit.set_positions, " ".join(typed))


def _positions_text(positions_mm: tuple[float, ...] | None) -> str:
    return " ".join(f"{position:g}" for position in positions_mm or ())


def _help(key: str) -> str:
    section = "recordings" if key == "target_frequency_hz" else section_of(key)
    return option(f"{section}.{key}").short_help


# A point is taken hold of within this distance.
REACH_PX = 8.0


class FoundView:
    """Buttons that search a recording, and what was found; `drawn` is called when the picture must change."""

    def __init__(self, state: PageState, drawn: Callable[[], None]) -> None:
        self._state, self._drawn = state, drawn
        self._detected: tuple[DetectedMarker, ...] = ()
        # By the number that is drawn, which stays when others are accepted.
        self._points: dict[int, Point] = {}
        self._line: tuple[Point, Point] | None = None
        self._fields: list[Any] = []
        with ui.row().classes("frames"):
            ui.button("Detect markers", on_click=self._detect)
            button("Propose", self._propose, "Propose points and a line")
        self._status = ui.label("").props('role="status"').classes("status")
        self._rows()
        state.when_draft_changes(self._show_names)

    def clear(self) -> None:
        """Forget what was found, for another recording."""
        self._detected, self._points, self._line = (), {}, None
        self._status.text = ""
        self._rows.refresh()

    def tell(self, text: str) -> None:
        """Show a message in the place of the last one."""
        self._status.text = shown(text)

    def overlay(self, frame: int) -> str:
        """What was found, to be drawn over the picture of a frame: detected markers over the frame they are seen in."""
        names = markers_edit.detected_names(self._state.recording, self._detected)
        named = zip(names, self._detected, strict=True)
        seen = [(name, one.x_px, one.y_px) for name, one in named if one.frame == frame]
        points = [(str(place), x, y) for place, (x, y) in self._points.items()]
        stations = self._state.recording.stations
        line = "" if self._line is None else drawn_line(self._line, stations, "proposed-beam")
        return line + marked(seen, "seen") + marked(points, "proposed")

    def accept_near(self, at: Point) -> bool:
        """Follow the proposed point at a click, if there is one."""
        numbers = tuple(self._points)
        nearest = markers_edit.nearest_point(tuple(self._points.values()), at, REACH_PX)
        if nearest is not None:
            self._accept_point(numbers[nearest])
        return nearest is not None

    @ui.refreshable_method
    def _rows(self) -> None:
        self._fields = [self._detected_row(k, one) for k, one in enumerate(self._detected)]
        self._show_names()
        if self._line is not None:
            (x0, y0), (x1, y1) = self._line
            with ui.row().classes("frames"):
                ui.label(f"Line from the clamp at ({x0:.0f}, {y0:.0f}) to ({x1:.0f}, {y1:.0f})")
                button("Use", self._accept_line, "Use the line")
        for place, (x, y) in self._points.items():
            with ui.row().classes("frames"):
                ui.label(f"{place} at ({x:.0f}, {y:.0f})")
                button("Use", partial(self._accept_point, place), f"Use point {place}")

    def _detected_row(self, k: int, one: DetectedMarker) -> Any:
        """Row of a detected marker; the result is the field of its name."""
        with ui.row().classes("frames"):
            later = f" in frame {one.frame}" if one.frame else ""
            field = ui.input(f"{one.name} at ({one.x_px:.0f}, {one.y_px:.0f}){later}")
            field.props("outlined dense").classes("number").props["aria-label"] = f"Name of {one.name}"
            field.on("change", lambda: self._rename(k, field.value or ""))
            button("Leave out", partial(self._leave_out, {k}), f"Leave out {one.name}")
            if len(self._detected) > 1:
                others = set(range(len(self._detected))) - {k}
                button("Keep only this", partial(self._leave_out, others), f"Keep only {one.name}")
        return field

    def _show_names(self) -> None:
        """Names as they are in the draft. The fields stay: one that was built anew would lose the focus."""
        names = markers_edit.detected_names(self._state.recording, self._detected)
        for field, name in zip(self._fields, names, strict=True):
            field.value = name

    def _rename(self, k: int, name: str) -> None:
        self._state.edit(markers_edit.rename_detected, self._detected, k, name)

    async def _leave_out(self, which: set[int]) -> None:
        if self._state.edit(markers_edit.leave_out, self._detected, which):
            await self._detect()

    def _accept_point(self, place: int) -> None:
        if self._state.edit(markers_edit.add_point, self._points[place]):
            del self._points[place]
            self._rows.refresh()
            self._drawn()

    def _accept_line(self) -> None:
        if self._line is not None and self._state.edit(markers_edit.set_line, *self._line):
            self._points, self._line = {}, None
            self.tell("")
            self._rows.refresh()
            self._drawn()

    async def _detect(self) -> None:
        self.tell("detecting markers")
        found = await in_thread(self._state.studio.detect, self._state.number)
        self._detected = () if isinstance(found, Failure) else found
        names = ", ".join(one.name for one in self._detected)
        frames = ", ".join(str(k) for k in sorted({one.frame for one in self._detected}))
        where = f"; drawn in frame {frames}"
        said = (
            found.reason if isinstance(found, Failure) else f"{len(found)} markers detected: {names}{where}"
        )
        self.tell(said)
        self._rows.refresh()
        self._drawn()

    async def _propose(self) -> None:
        self.tell("looking for what moves")
        found = await in_thread(self._state.studio.propose, self._state.number)
        if isinstance(found, Failure):
            self.tell(found.reason)
            return
        self._points = dict(enumerate(found.points, 1))
        self._line = found.line
        points = (
            "Click a proposed point, or press Use beside it, where it lies on the part that vibrates."
            if found.points
            else "No texture that moves was found."
        )
        line = "The dashed line is a strip that moves." if found.line else f"No line: {found.no_line}."
        self.tell(f"{points} {line}")
        self._rows.refresh()
        self._drawn()

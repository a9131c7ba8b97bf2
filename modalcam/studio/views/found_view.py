"""Markers detected in a recording, and points and a line that could be followed: to name, accept or leave out."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import ui

from modalcam.names import shown
from modalcam.studio import markers_edit
from modalcam.studio.decoding import Problem
from modalcam.studio.overlay import Point, drawn_line, marked
from modalcam.studio.views.shared import PageState, in_thread

if TYPE_CHECKING:
    from modalcam.studio.trial import DetectedMarker

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
            ui.button("Propose", on_click=self._propose).props["aria-label"] = "Propose points and a line"
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
        names = markers_edit.detected_names(self._recording(), self._detected)
        named = zip(names, self._detected, strict=True)
        seen = [(name, one.x_px, one.y_px) for name, one in named if one.frame == frame]
        points = [(str(number), x, y) for number, (x, y) in self._points.items()]
        line = (
            "" if self._line is None else drawn_line(self._line, self._recording().stations, "proposed-beam")
        )
        return line + marked(seen, "seen") + marked(points, "proposed")

    def accept_near(self, at: Point) -> bool:
        """Follow the proposed point at a click, if there is one."""
        numbers = tuple(self._points)
        nearest = markers_edit.nearest_point(tuple(self._points.values()), at, REACH_PX)
        if nearest is not None:
            self._accept_point(numbers[nearest])
        return nearest is not None

    def _recording(self) -> Any:
        return self._state.studio.draft.recording(self._state.file)

    @ui.refreshable_method
    def _rows(self) -> None:
        self._fields = [self._detected_row(k, one) for k, one in enumerate(self._detected)]
        self._show_names()
        if self._line is not None:
            (x0, y0), (x1, y1) = self._line
            with ui.row().classes("frames"):
                ui.label(f"Line from the clamp at ({x0:.0f}, {y0:.0f}) to ({x1:.0f}, {y1:.0f})")
                _button("Use", self._accept_line, "Use the line")
        for number, (x, y) in self._points.items():
            with ui.row().classes("frames"):
                ui.label(f"{number} at ({x:.0f}, {y:.0f})")
                _button("Use", partial(self._accept_point, number), f"Use point {number}")

    def _detected_row(self, k: int, one: DetectedMarker) -> Any:
        """Row of a detected marker; the result is the field of its name."""
        with ui.row().classes("frames"):
            later = f" in frame {one.frame}" if one.frame else ""
            field = ui.input(f"{one.name} at ({one.x_px:.0f}, {one.y_px:.0f}){later}")
            field.props("outlined dense").classes("number").props["aria-label"] = f"Name of {one.name}"
            field.on("change", lambda: self._rename(k, field.value or ""))
            _button("Leave out", partial(self._leave_out, {k}), f"Leave out {one.name}")
            if len(self._detected) > 1:
                others = set(range(len(self._detected))) - {k}
                _button("Keep only this", partial(self._leave_out, others), f"Keep only {one.name}")
        return field

    def _show_names(self) -> None:
        """Names as they are in the draft. The fields stay: one that was built anew would lose the focus."""
        names = markers_edit.detected_names(self._recording(), self._detected)
        for field, name in zip(self._fields, names, strict=True):
            field.value = name

    def _rename(self, k: int, name: str) -> None:
        draft, file = self._state.studio.draft, self._state.file
        self._state.attempt(lambda: markers_edit.rename_detected(draft, file, self._detected, k, name))

    async def _leave_out(self, which: set[int]) -> None:
        draft, file = self._state.studio.draft, self._state.file
        if self._state.attempt(lambda: markers_edit.leave_out(draft, file, self._detected, which)):
            await self._detect()

    def _accept_point(self, number: int) -> None:
        draft, file, at = self._state.studio.draft, self._state.file, self._points[number]
        if self._state.attempt(lambda: markers_edit.add_point(draft, file, at)):
            del self._points[number]
            self._rows.refresh()
            self._drawn()

    def _accept_line(self) -> None:
        draft, file, line = self._state.studio.draft, self._state.file, self._line
        if line is not None and self._state.attempt(lambda: markers_edit.set_line(draft, file, *line)):
            self._points, self._line = {}, None
            self.tell("")
            self._rows.refresh()
            self._drawn()

    async def _detect(self) -> None:
        self.tell("detecting markers")
        found = await in_thread(self._state.studio.detect, self._state.number)
        self._detected = () if isinstance(found, Problem) else found
        names = ", ".join(one.name for one in self._detected)
        frames = ", ".join(str(k) for k in sorted({one.frame for one in self._detected}))
        where = f"; drawn in frame {frames}"
        said = (
            found.reason if isinstance(found, Problem) else f"{len(found)} markers detected: {names}{where}"
        )
        self.tell(said)
        self._rows.refresh()
        self._drawn()

    async def _propose(self) -> None:
        self.tell("looking for what moves")
        found = await in_thread(self._state.studio.propose, self._state.number)
        if isinstance(found, Problem):
            self.tell(found.reason)
            return
        # What is followed already need not be proposed.
        own = self._recording().points_px or ()
        new = (p for p in found.points if markers_edit.nearest_point(own, p, REACH_PX) is None)
        self._points = dict(enumerate(new, 1))
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


def _button(text: str, action: Callable[[], Any], name: str) -> None:
    """A button with a longer name for a screen reader."""
    ui.button(text, on_click=action).props["aria-label"] = name

"""Any frame of a recording, with its markers: set by clicks, or by numbers from the keyboard."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import background_tasks, ui

from modalcam.errors import ModalcamError
from modalcam.names import shown
from modalcam.studio import markers_edit
from modalcam.studio.decoding import Problem
from modalcam.studio.overlay import Point, in_image, marked, overlay
from modalcam.studio.views.marker_form import MarkerForm
from modalcam.studio.views.shared import PageState, complain, heading, in_thread

if TYPE_CHECKING:
    from modalcam.config.schema import RecordingConfig
    from modalcam.studio.trial import DetectedMarker

TOOLS = {
    "point": "Patch: click a point with texture that moves",
    "line": "Line: click or drag from the clamped end to the free end",
    "scale": "Scale: click or drag between two points of known distance",
    "region": "Leave out: click or drag between two corners of a region",
    "look": "Look only",
}
# A point is taken hold of within this distance.
_REACH_PX = 8.0
# A press and a release farther apart than this are a drag.
_DRAG_PX = 1.5


class FrameView:
    """The picture with its controls on the left, the form of the markers on the right."""

    def __init__(self, state: PageState) -> None:
        self._state = state
        self._pending: list[Point] = []
        self._pressed: Point | None = None
        self._proposed: tuple[Point, ...] = ()
        # Windows of the patches, and the options that they were chosen with.
        self._sizes: tuple[RecordingConfig | None, tuple[float, ...]] = None, ()
        self._detected: tuple[DetectedMarker, ...] = ()
        heading("Frame and markers")
        with ui.row().classes("two-columns"):
            with ui.column().classes("wide"):
                self._controls()
                self._picture()
                self._display()
            with ui.column().classes("narrow"):
                self._tools()
                self._form = MarkerForm(state)
        state.when_draft_changes(self._draw)
        state.when_recording_changes(self._changed_recording)
        ui.timer(0.1, self._count, once=True)
        self._draw()

    def _controls(self) -> None:
        names = {number: shown(r.file) for number, r in enumerate(self._state.studio.recordings)}
        self._select = (
            ui.select(
                names,
                label="Recording",
                value=self._state.number,
                on_change=lambda e: self._state.choose(e.value),
            )
            .props("outlined dense options-dense")
            .classes("recording")
        )
        with ui.row().classes("frames"):
            self._index = ui.number("Frame", value=0, min=0, step=1, format="%d", on_change=self._show)
            self._index.props("outlined dense debounce=150").classes("number")
            self._slider = ui.slider(
                min=0, max=0, value=0, on_change=lambda e: self._index.set_value(e.value)
            )
            self._slider.props('aria-label="Frame" debounce=100').classes("long")
            self._total = ui.label("counting frames")

    def _picture(self) -> None:
        box = ui.element("div").classes("frame-box").props('tabindex="0" role="region"')
        box.props["aria-label"] = "Picture; plus and minus zoom, arrow keys scroll"
        with box, ui.element("div").classes("frame-canvas"):
            self._image = ui.interactive_image(
                self._source(), on_mouse=self._mouse, events=["mousedown", "mouseup"], cross="#d81b60"
            ).classes("frame-image")
            self._image.props["alt"] = "Frame of the recording"

    def _display(self) -> None:
        with ui.row().classes("frames"):
            for label, factor, name in (
                ("−", 0.8, "Zoom out"),
                ("+", 1.25, "Zoom in"),
                ("Fit", 0.0, "Fit to window"),
            ):
                button = ui.button(
                    label, on_click=lambda factor=factor: ui.run_javascript(f"zoomFrame({factor})")
                )
                button.props["aria-label"] = name
            ui.label("Brightness")
            bright = (
                ui.slider(min=0.2, max=6.0, step=0.1, value=1.0)
                .props('aria-label="Brightness"')
                .classes("short")
            )
            ui.label("Contrast")
            contrast = (
                ui.slider(min=0.2, max=6.0, step=0.1, value=1.0)
                .props('aria-label="Contrast"')
                .classes("short")
            )

            def apply() -> None:
                self._image.style(f"--frame-filter: brightness({bright.value}) contrast({contrast.value})")

            bright.on_value_change(apply)
            contrast.on_value_change(apply)

    def _tools(self) -> None:
        self._tool = ui.radio(TOOLS, value="point", on_change=self._drop_pending).props(
            'aria-label="What a click does"'
        )
        with ui.row().classes("frames"):
            x = ui.number("x / px", value=0, step=1).props("outlined dense").classes("number")
            y = ui.number("y / px", value=0, step=1).props("outlined dense").classes("number")
            ui.button("Add", on_click=lambda: self._place((float(x.value or 0), float(y.value or 0))))
        with ui.row().classes("frames"):
            ui.button("Detect markers", on_click=self._detect)
            ui.button("Propose points", on_click=self._propose)
        self._status = ui.label("").props('role="status"').classes("status")
        self._found()

    @ui.refreshable_method
    def _found(self) -> None:
        """Detected markers and proposed points, each with what can be done with it."""
        for one in self._detected:
            with ui.row().classes("frames"):
                ui.label(f"{one.name} at ({one.x_px:.0f}, {one.y_px:.0f})")
                _button("Leave out", partial(self._leave_out, one), f"Leave out {one.name}")
                if len(self._detected) > 1:
                    _button("Keep only this", partial(self._keep_only, one), f"Keep only {one.name}")
        for number, (x, y) in enumerate(self._proposed, 1):
            with ui.row().classes("frames"):
                ui.label(f"{number} at ({x:.0f}, {y:.0f})")
                _button("Use", partial(self._accept, (x, y)), f"Use point {number}")

    def _accept(self, at: Point) -> None:
        """Follow a proposed point."""
        draft, file = self._state.studio.draft, self._state.file
        if self._state.attempt(lambda: markers_edit.add_point(draft, file, at)):
            self._proposed = tuple(point for point in self._proposed if point != at)
            self._found.refresh()
            self._draw()

    async def _keep_only(self, kept: DetectedMarker) -> None:
        draft, file = self._state.studio.draft, self._state.file
        others = [((one.x_px, one.y_px), one.size_px) for one in self._detected if one is not kept]
        if self._state.attempt(lambda: markers_edit.keep_only(draft, file, others)):
            await self._detect()

    async def _leave_out(self, one: DetectedMarker) -> None:
        draft, file = self._state.studio.draft, self._state.file
        if self._state.attempt(
            lambda: markers_edit.leave_out(draft, file, (one.x_px, one.y_px), one.size_px)
        ):
            await self._detect()

    def _source(self) -> str:
        return f"/frame/{self._state.number}/{int(self._index.value or 0)}.png"

    def _show(self) -> None:
        last = int(self._slider.props.get("max", 0))
        index = min(max(int(self._index.value or 0), 0), last) if last else int(self._index.value or 0)
        self._slider.value = index
        self._status.text = shown(self._state.studio.missing(self._state.number))
        self._image.set_source(self._source())

    async def _count(self) -> None:
        number = self._state.number
        count = await in_thread(self._state.studio.frame_count, number)
        if number != self._state.number:
            return
        if isinstance(count, Problem):
            self._total.text = shown(count.reason)
            return
        self._total.text = f"of {count} (0 to {count - 1})"
        self._slider.props["max"] = max(count - 1, 0)
        self._index.max = max(count - 1, 0)

    def _changed_recording(self) -> None:
        self._select.value = self._state.number
        self._index.value = 0
        self._slider.props["max"] = 0
        self._total.text = "counting frames"
        self._status.text = ""
        self._detected, self._proposed = (), ()
        self._found.refresh()
        self._drop_pending()
        self._image.set_source(self._source())
        self._draw()
        background_tasks.create(self._count())

    def _mouse(self, event: Any) -> None:
        at = in_image(event.image_x, event.image_y)
        if event.type == "mousedown":
            self._pressed = at
            return
        pressed, self._pressed = self._pressed, None
        if pressed is None or self._tool.value == "look":
            return
        points = self._state.studio.draft.recording(self._state.file).points_px or ()
        held = markers_edit.nearest_point(points, pressed, _REACH_PX)
        moved = max(abs(at[0] - pressed[0]), abs(at[1] - pressed[1])) > _DRAG_PX
        if not moved or (held is None and self._tool.value == "point"):
            self._place(at)
        elif self._tool.value != "point":
            self._pending = []
            self._place(pressed)
            self._place(at)
        elif held is not None:
            draft, file = self._state.studio.draft, self._state.file
            self._state.attempt(lambda: markers_edit.move_point(draft, file, held, at))

    def _place(self, at: Point) -> None:
        """What a click at a point of the image does with the chosen tool."""
        draft, file, tool = self._state.studio.draft, self._state.file, self._tool.value
        if tool == "point":
            proposed = markers_edit.nearest_point(self._proposed, at, _REACH_PX)
            if proposed is not None:
                self._accept(self._proposed[proposed])
                return
            self._state.attempt(lambda: markers_edit.add_point(draft, file, at))
        elif tool != "look":
            self._pending.append(at)
            if len(self._pending) == 2:
                first, second = self._pending
                self._pending = []
                if tool == "line":
                    self._state.attempt(lambda: markers_edit.set_line(draft, file, first, second))
                elif tool == "region":
                    self._state.attempt(lambda: markers_edit.add_region(draft, file, first, second))
                else:
                    self._ask_length((first, second))
        self._draw()

    def _ask_length(self, ends: tuple[Point, Point]) -> None:
        with ui.dialog(value=True).props('aria-label="Scale"') as dialog, ui.card():
            ui.label("Distance between the two points")
            length = ui.number("Length / mm", min=0).props("outlined dense autofocus")

            def accept() -> None:
                if not length.value or length.value <= 0:
                    complain("expected a length in mm, a positive number")
                    return
                draft, file = self._state.studio.draft, self._state.file
                self._state.attempt(lambda: markers_edit.set_scale(draft, file, ends, float(length.value)))
                dialog.close()

            with ui.row():
                ui.button("Set the scale", on_click=accept)
                ui.button("Cancel", on_click=dialog.close)

    async def _detect(self) -> None:
        self._status.text = "detecting markers"
        found = await in_thread(self._state.studio.detect, self._state.number)
        self._detected = () if isinstance(found, Problem) else found
        self._status.text = (
            shown(found.reason)
            if isinstance(found, Problem)
            else f"{len(found)} markers detected: {', '.join(one.name for one in found)}"
        )
        self._found.refresh()
        self._draw()

    async def _propose(self) -> None:
        self._status.text = "looking for texture that moves"
        found = await in_thread(self._state.studio.propose, self._state.number)
        if isinstance(found, Problem):
            self._status.text = shown(found.reason)
            return
        # What is followed already need not be proposed.
        own = self._state.studio.draft.recording(self._state.file).points_px or ()
        self._proposed = tuple(at for at in found if markers_edit.nearest_point(own, at, _REACH_PX) is None)
        self._status.text = (
            "Click a proposed point, or press Use beside it, where it lies on the part that vibrates."
            if found
            else "No texture that moves was found."
        )
        self._found.refresh()
        self._draw()

    async def _measure(self, recording: RecordingConfig) -> None:
        """Draw the windows of the patches as large as a run chooses them."""
        self._sizes = recording, self._sizes[1]
        sizes = await in_thread(self._state.studio.window_sizes, self._state.number)
        if self._sizes[0] is recording:
            self._sizes = recording, sizes
            self._draw()

    def _drop_pending(self) -> None:
        self._pending = []
        self._draw()

    def _draw(self) -> None:
        try:
            recording = self._state.studio.draft.recording(self._state.file)
            own = overlay(recording, self._pending, self._sizes[1])
            if recording.kind == "patch" and recording.size_px is None and recording != self._sizes[0]:
                background_tasks.create(self._measure(recording))
        except ModalcamError as error:
            own = ""
            complain(str(error))
        seen = [(one.name, one.x_px, one.y_px) for one in self._detected]
        proposed = [(str(number), x, y) for number, (x, y) in enumerate(self._proposed, 1)]
        self._image.content = own + marked(seen, "seen") + marked(proposed, "proposed")


def _button(text: str, action: Callable[[], Any], name: str) -> None:
    """A button with a longer name for a screen reader."""
    ui.button(text, on_click=action).props["aria-label"] = name

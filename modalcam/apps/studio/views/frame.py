"""Any frame of a recording, with its markers: set by clicks, or by numbers from the keyboard."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import background_tasks, ui

from modalcam.apps.studio import markers as markers_edit
from modalcam.apps.studio.frames import Point, in_image, overlay
from modalcam.apps.studio.views.markers import REACH_PX, FoundView, MarkerForm
from modalcam.apps.studio.views.shared import PageState, button, complain, heading, in_thread, number
from modalcam.common import ModalcamError, shown
from tracker import Failure
from tracker.markers import kind_of

if TYPE_CHECKING:
    from modalcam.config import RecordingConfig

TOOLS = {
    "point": "Patch: click a point with texture that moves",
    "line": "Line: click or drag from the clamped end to the free end",
    "scale": "Scale: click or drag between two points of known distance",
    "region": "Leave out: click or drag between two corners of a region",
    "look": "Look only",
}
# A press and a release farther apart than this are a drag.
_DRAG_PX = 1.5


class FrameView:
    """The picture with its controls on the left, the form of the markers on the right."""

    def __init__(self, state: PageState) -> None:
        self._state = state
        self._pending: list[Point] = []
        self._pressed: Point | None = None
        # Windows of the patches, and the options that they were chosen with.
        self._sizes: tuple[RecordingConfig | None, tuple[float, ...]] = None, ()
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
        with ui.row().classes("frames"):
            self._index = number("Frame", value=0, min=0, step=1, format="%d", on_change=self._show)
            self._index.props("debounce=50")
            self._slider = ui.slider(
                min=0, max=0, value=0, on_change=lambda e: self._index.set_value(e.value)
            )
            self._slider.props('aria-label="Frame" debounce=50').classes("long")
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
            zooms = (("−", 0.8, "Zoom out"), ("+", 1.25, "Zoom in"), ("Fit", 0.0, "Fit to window"))
            for label, factor, name in zooms:
                button(label, partial(ui.run_javascript, f"zoomFrame({factor})"), name)

            def apply() -> None:
                self._image.style(f"--frame-filter: brightness({bright.value}) contrast({contrast.value})")

            bright, contrast = _filter("Brightness", apply), _filter("Contrast", apply)

    def _tools(self) -> None:
        self._tool = ui.radio(TOOLS, value="point", on_change=self._drop_pending).props(
            'aria-label="What a click does"'
        )
        with ui.row().classes("frames"):
            x, y = (number(f"{axis} / px", value=0, step=1) for axis in "xy")
            ui.button("Add", on_click=lambda: self._place((float(x.value or 0), float(y.value or 0))))
        self._found = FoundView(self._state, self._draw)

    def _source(self) -> str:
        return f"/frame/{self._state.number}/{int(self._index.value or 0)}.png"

    def _show(self) -> None:
        last = int(self._slider.props.get("max", 0))
        index = min(max(int(self._index.value or 0), 0), last) if last else int(self._index.value or 0)
        self._slider.value = index
        self._found.tell(self._state.studio.missing(self._state.number))
        self._image.set_source(self._source())
        self._draw()

    async def _count(self) -> None:
        at = self._state.number
        count = await in_thread(self._state.studio.frame_count, at)
        if at != self._state.number:
            return
        if isinstance(count, Failure):
            self._total.text = shown(count.reason)
            return
        self._total.text = f"of {count} (0 to {count - 1})"
        self._slider.props["max"] = max(count - 1, 0)
        self._index.max = max(count - 1, 0)

    def _changed_recording(self) -> None:
        self._index.value = 0
        self._slider.props["max"] = 0
        self._total.text = "counting frames"
        self._found.clear()
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
        points = self._state.recording.points_px or ()
        held = markers_edit.nearest_point(points, pressed, REACH_PX)
        moved = max(abs(at[0] - pressed[0]), abs(at[1] - pressed[1])) > _DRAG_PX
        if not moved or (held is None and self._tool.value == "point"):
            self._place(at)
        elif self._tool.value != "point":
            self._pending = []
            self._place(pressed)
            self._place(at)
        elif held is not None:
            self._state.edit(markers_edit.move_point, held, at)

    def _place(self, at: Point) -> None:
        """What a click at a point of the image does with the chosen tool."""
        tool = self._tool.value
        if tool == "point":
            if self._found.accept_near(at):
                return
            self._state.edit(markers_edit.add_point, at)
        elif tool != "look":
            self._pending.append(at)
            if len(self._pending) == 2:
                first, second = self._pending
                self._pending = []
                if tool == "scale":
                    self._ask_length((first, second))
                else:
                    change = markers_edit.set_line if tool == "line" else markers_edit.add_region
                    self._state.edit(change, first, second)
        self._draw()

    def _ask_length(self, ends: tuple[Point, Point]) -> None:
        with ui.dialog(value=True).props('aria-label="Scale"') as dialog, ui.card():
            ui.label("Distance between the two points")
            length = number("Length / mm", min=0).props("autofocus")

            def accept() -> None:
                if not length.value or length.value <= 0:
                    complain("expected a length in mm, a positive number")
                    return
                self._state.edit(markers_edit.set_scale, ends, float(length.value))
                dialog.close()

            with ui.row():
                ui.button("Set the scale", on_click=accept)
                ui.button("Cancel", on_click=dialog.close)

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
            recording = self._state.recording
            own = overlay(recording, self._pending, self._sizes[1])
            if (
                not kind_of(recording.kind).is_sought
                and recording.size_px is None
                and recording != self._sizes[0]
            ):
                background_tasks.create(self._measure(recording))
        except ModalcamError as error:
            own = ""
            complain(str(error))
        self._image.content = own + self._found.overlay(int(self._index.value or 0))


def _filter(label: str, apply: Callable[[], None]) -> Any:
    """Slider of a filter of the picture."""
    ui.label(label)
    slider = ui.slider(min=0.2, max=6.0, step=0.1, value=1.0, on_change=apply).classes("short")
    return slider.props(f'aria-label="{label}"')

"""The page of the studio: its views as tabs."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from nicegui import background_tasks, ui

from modalcam.apps.studio.session import Studio
from modalcam.apps.studio.views.decay import DecayView
from modalcam.apps.studio.views.frame import FrameView
from modalcam.apps.studio.views.recordings import BeamView, RecordingsView
from modalcam.apps.studio.views.run import RunView, TrialView
from modalcam.apps.studio.views.shared import PageState, SaveBar, SaveDialog, WhereBar
from modalcam.common import shown

_ASSETS = Path(__file__).parent
_TICK_S = 0.5
_VIEWS = ("Recordings", "Markers", "Beam", "Test track", "Run and report", "Decay")


def build_page(studio: Studio) -> None:
    """Build the page for one browser tab."""
    _look()
    state = PageState(studio)
    ui.page_title("modalcam studio")
    dialog = SaveDialog(state)
    with ui.header().classes("bar"):
        with ui.element("h1"):
            ui.label("modalcam studio")
        with ui.tabs().props('aria-label="Views" no-caps') as tabs:
            names = [ui.tab(name) for name in _VIEWS]
        ui.space()
        SaveBar(state, dialog)
    for note in studio.draft.notes:
        ui.label(note).classes("notice")
    with ui.element("div").classes("views"):
        where = WhereBar(state, partial(_tick, dict(zip(_VIEWS, names, strict=True))))
        with ui.tab_panels(tabs, value=names[0]).props("keep-alive").classes("panels"):
            with ui.tab_panel(names[0]):
                RecordingsView(state, lambda: tabs.set_value(_VIEWS[1]))
            with ui.tab_panel(names[1]):
                FrameView(state)
            with ui.tab_panel(names[2]):
                BeamView(state)
            with ui.tab_panel(names[3]):
                TrialView(state)
            with ui.tab_panel(names[4]):
                RunView(state, dialog)
            with ui.tab_panel(names[5]):
                decay = DecayView(state)

    def look_at_decay() -> None:
        if tabs.value == _VIEWS[5]:
            background_tasks.create(decay.opened())

    tabs.on_value_change(look_at_decay)
    state.when_recording_changes(look_at_decay)
    # Another page of the same studio may change the draft.
    ui.timer(_TICK_S, state.look)
    ui.timer(_TICK_S, where.look)


def _tick(tabs: dict[str, ui.tab], done: frozenset[str]) -> None:
    for name, tab in tabs.items():
        tab.props["label"] = f"{name} ✓" if name in done else name


def build_pick_page(studio: Studio) -> None:
    """Build the page of `modalcam pick`: one recording, its frames and its markers."""
    _look()
    state = PageState(studio)
    ui.page_title("modalcam pick")
    dialog = SaveDialog(state)
    with ui.header().classes("bar"):
        with ui.element("h1"):
            ui.label(f"modalcam pick: {shown(state.file)}")
        ui.space()
        SaveBar(state, dialog)
        if studio.draft.can_be_saved:
            ui.button("Done", on_click=lambda: dialog.ask(partial(_end, studio), "Save and end"))
        else:
            ui.button("Done", on_click=lambda: _end(studio))
    with ui.element("div").classes("views single"):
        FrameView(state)
    ui.timer(_TICK_S, state.look)


def _end(studio: Studio) -> None:
    # Its answer stops the server: the page would otherwise try to reach it again.
    studio.is_done = True
    ui.navigate.to("/done")


def _look() -> None:
    ui.colors(primary="#00664a", negative="#a8326e", positive="#00664a")
    ui.add_css((_ASSETS / "studio.css").read_text("utf-8"))
    script = (_ASSETS / "zoom.js").read_text("utf-8")
    ui.add_head_html(f"<script>{script}</script>")

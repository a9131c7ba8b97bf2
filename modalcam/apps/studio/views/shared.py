"""What all views of one open page share: its state, and saving with the difference shown first, and undo."""

from __future__ import annotations

from asyncio import CancelledError
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, TypeVar

from nicegui import core, run, ui

from modalcam.apps.studio.next_step import Rank, done_views, next_step
from modalcam.apps.studio.session import Studio
from modalcam.common import ModalcamError, for_terminal, shown
from modalcam.config import RecordingConfig
from modalcam.inputs import Found

Result = TypeVar("Result")


class PageState:
    """What one open page shows; several pages may show one studio.

    Attributes
    ----------
    number : int
        The recording that is shown.
    """

    def __init__(self, studio: Studio) -> None:
        self.studio = studio
        self.number = 0
        self._seen = studio.draft.version
        self._on_draft: list[Callable[[], Any]] = []
        self._on_recording: list[Callable[[], Any]] = []

    @property
    def found(self) -> Found:
        """The recording that is shown."""
        return self.studio.recordings[self.number]

    @property
    def file(self) -> str:
        """Its path in the folder, by which the configuration names it."""
        return self.found.file

    def when_draft_changes(self, action: Callable[[], Any]) -> None:
        """Call this after each change of the draft, also by another page."""
        self._on_draft.append(action)

    def when_recording_changes(self, action: Callable[[], Any]) -> None:
        """Call this after another recording was chosen."""
        self._on_recording.append(action)

    def choose(self, number: int) -> None:
        """Show another recording."""
        if number != self.number and 0 <= number < len(self.studio.recordings):
            self.number = number
            for action in self._on_recording:
                action()

    def look(self) -> None:
        """Notice changes of the draft."""
        if self._seen != self.studio.draft.version:
            self._seen = self.studio.draft.version
            for action in self._on_draft:
                action()

    @property
    def recording(self) -> RecordingConfig:
        """Its options in the draft."""
        return self.studio.draft.recording(self.file)

    def edit(self, change: Callable[..., Any], *values: Any) -> bool:
        """Make a change of `modalcam.apps.studio.markers` to the recording, or say why it cannot be made."""
        return self.attempt(partial(change, self.studio.draft, self.file, *values))

    def attempt(self, action: Callable[[], Any]) -> bool:
        """Make a change, or say why it cannot be made; shows the draft as it is then."""
        try:
            action()
            self.look()
        except ModalcamError as error:
            complain(str(error))
            for refresh in self._on_draft:
                refresh()
            return False
        return True


# Reading takes a second for about 15 letters, and some for looking up.
_LOOK_UP_MS, _LETTER_MS = 6000, 70


def complain(text: str) -> None:
    """Show a message below the bar of the page, until it has been read or is closed."""
    timeout = _LOOK_UP_MS + _LETTER_MS * len(text)
    ui.notify(
        shown(text),
        type="negative",
        multi_line=True,
        close_button="Close",
        timeout=timeout,
        position="top-right",
    )


async def in_thread(function: Callable[..., Result], *arguments: Any) -> Result:
    """Result of a call that blocks; cancelled where the server ends, for which NiceGUI gives None."""
    result: Result = await run.io_bound(function, *arguments)
    if core.app.is_stopping:
        raise CancelledError
    return result


def heading(text: str, level: int = 2) -> Any:
    """A heading of the page."""
    with ui.element(f"h{level}") as element:
        ui.label(text)
    return element


def button(text: str, action: Callable[..., Any], name: str = "") -> Any:
    """A button, with a longer name for a screen reader where its text says too little."""
    element = ui.button(text, on_click=action)
    if name:
        element.props["aria-label"] = name
    return element


def number(label: str, width: str = "number", **options: Any) -> Any:
    """A field for a number, as wide as the class `width` of the style sheet."""
    return ui.number(label, **options).props("outlined dense").classes(width)


def remark(rank: Rank, text: str) -> None:
    """A sentence that begins with its rank, for readers who do not see its colour."""
    ui.label(f"{rank.word}: {shown(text)}").classes(f"remark {rank.word.lower()}")


def table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """A table of texts."""
    with scrolled(), ui.element("table").classes("list"):
        table_head(columns)
        with ui.element("tbody"):
            for row in rows:
                with ui.element("tr"):
                    for k, text in enumerate(row):
                        # The first cell is the name of the row.
                        with ui.element("td") if k else ui.element("th").props('scope="row"'):
                            ui.label(text)


def table_head(columns: Iterable[str]) -> None:
    """The first row of a table, of headings."""
    with ui.element("thead"), ui.element("tr"):
        for name in columns:
            with ui.element("th").props('scope="col"'):
                ui.label(name)


def scrolled() -> Any:
    """Box around a table that may be wider than the page; the keyboard scrolls it, too."""
    return ui.element("div").classes("scrolled").props('tabindex="0" role="group" aria-label="Table"')


class WhereBar:
    """The recording that all views show, and what to do next; `ticked` is told the names of the views that are done."""

    def __init__(self, state: PageState, ticked: Callable[[frozenset[str]], None]) -> None:
        self._state, self._ticked = state, ticked
        names = dict(enumerate(shown(found.file) for found in state.studio.recordings))
        with ui.row().classes("where"):
            select = ui.select(
                names, label="Recording", value=state.number, on_change=lambda e: state.choose(e.value)
            )
            select.props("outlined dense options-dense").classes("recording")
            self._step = ui.label("").props('role="status"').classes("next-step")
        state.when_recording_changes(lambda: select.set_value(state.number))
        self.look()

    def look(self) -> None:
        """Show how far the work is now."""
        stand = self._state.studio.stand()
        self._step.text = shown(next_step(stand))
        self._ticked(done_views(stand))


class SaveDialog:
    """Shows what saving would change and asks whether to do it."""

    def __init__(self, state: PageState) -> None:
        self._state = state

    def ask(self, then: Callable[[], None] | None = None, label: str = "Save") -> None:
        """Save after confirmation, by a button with this label, and then call `then`; without changes, at once."""
        draft = self._state.studio.draft
        if not draft.is_changed:
            if then is None:
                ui.notify("There are no changes to save.")
            else:
                then()
            return

        def save() -> None:
            dialog.close()
            try:
                draft.save()
            except ModalcamError as error:
                complain(str(error))
                return
            self._state.look()
            ui.notify(f"{shown(draft.path.name)} saved", type="positive")
            if then is not None:
                then()

        with (
            ui.dialog(value=True).props('aria-label="Changes to be saved"') as dialog,
            ui.card().classes("difference"),
        ):
            heading(f"Changes of {shown(draft.path.name)}", 3)
            ui.label(f"The file is in {shown(str(draft.path.parent))}.")
            with ui.element("pre").classes("messages").props('tabindex="0" aria-label="Changes"'):
                ui.label(for_terminal(draft.difference()))
            with ui.row():
                ui.button(label, on_click=save)
                ui.button("Cancel", on_click=dialog.close)


class SaveBar:
    """Undo and save, and whether there is anything to save."""

    def __init__(self, state: PageState, dialog: SaveDialog) -> None:
        draft = state.studio.draft
        with ui.row().classes("save-bar"):
            self._label = ui.label("").props('role="status"')
            self._undo = ui.button("Undo", on_click=lambda: state.attempt(draft.undo))
            self._again = ui.button("Start over", on_click=self._begin_again)
            self._again.visible = draft.can_be_saved
            self._save = ui.button("Save", on_click=partial(dialog.ask, None))
            self._save.visible = draft.can_be_saved
        self._state = state
        state.when_draft_changes(self._refresh)
        self._refresh()

    def _begin_again(self) -> None:
        if self._state.attempt(self._state.studio.draft.begin_again):
            ui.notify("The file as it is on disk; undo brings the changes back.")

    def _refresh(self) -> None:
        draft = self._state.studio.draft
        if draft.can_be_saved:
            self._label.text = "unsaved changes" if draft.is_changed else "saved"
        self._undo.set_enabled(draft.can_undo)
        self._again.set_enabled(draft.is_changed)
        self._save.set_enabled(draft.is_changed)

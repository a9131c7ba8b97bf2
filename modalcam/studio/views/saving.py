"""Saving with the difference shown first, and undo."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import ui

from modalcam.errors import ModalcamError
from modalcam.names import for_terminal, shown
from modalcam.studio.views.shared import PageState, complain, heading


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

"""State of one open page, and what all its views share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from nicegui import run, ui

from modalcam.errors import ModalcamError
from modalcam.inputs import Found
from modalcam.names import shown
from modalcam.studio.session import Studio

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

    def attempt(self, action: Callable[[], Any]) -> bool:
        """Make a change, or say why it cannot be made; shows the draft as it is then."""
        with complaints():
            action()
            self.look()
            return True
        for refresh in self._on_draft:
            refresh()
        return False


@contextmanager
def complaints() -> Iterator[None]:
    """Show an expected error of the block as a message."""
    try:
        yield
    except ModalcamError as error:
        complain(str(error))


def complain(text: str) -> None:
    """Show a message that stays until it is closed."""
    ui.notify(shown(text), type="negative", multi_line=True, close_button="Close", timeout=0)


async def in_thread(function: Callable[..., Result], *arguments: Any) -> Result:
    """Result of a call that blocks."""
    result: Result = await run.io_bound(function, *arguments)
    return result


def heading(text: str, level: int = 2) -> Any:
    """A heading of the page."""
    with ui.element(f"h{level}") as element:
        ui.label(text)
    return element


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

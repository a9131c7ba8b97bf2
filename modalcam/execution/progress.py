"""Interface through which a run reports what it is doing; the console implements it."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Listener to the stages of a run. Calls come from the thread that runs the pipeline."""

    def begin(self, stage: str, total: int) -> None:
        """`stage` starts with `total` tasks."""

    def advance(self, name: str, *, reused: bool = False) -> None:
        """The task `name` of the current stage has ended; `reused` if its saved result was still valid."""

    def say(self, text: str) -> None:
        """Show a message now, such as the answer to an interrupt."""


class Silent:
    """Listener that shows nothing, for use as a library."""

    def begin(self, stage: str, total: int) -> None:
        """Do nothing."""

    def advance(self, name: str, *, reused: bool = False) -> None:
        """Do nothing."""

    def say(self, text: str) -> None:
        """Do nothing."""

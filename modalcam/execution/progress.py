"""What a run tells while it works, free of any console."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Listener to the stages of a run."""

    def begin(self, stage: str, total: int) -> None:
        """`stage` starts with `total` tasks."""

    def advance(self, name: str) -> None:
        """The task `name` of the stage has ended."""

"""Files of OUT that are written only if what they show, or the file itself, has changed."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from modalcam.storage.atomic import write_text
from modalcam.storage.output_folder import Workspace
from modalcam.storage.provenance import file_sha256


class Outputs:
    """Record of the files that runs wrote into OUT: the key and the SHA-256 of each.

    Parameters
    ----------
    workspace : Workspace
        Its `written` is the record; a missing or damaged one means that every file is written again.
    force : bool
        Write every file again.
    """

    def __init__(self, workspace: Workspace, *, force: bool = False) -> None:
        self._workspace = workspace
        self._written: dict[str, list[str]] = {}
        if force:
            return
        with suppress(OSError, ValueError):
            self._written = dict(json.loads(workspace.written.read_text("utf-8")))

    def write(self, path: Path, key: str, write: Callable[[Path], object]) -> bool:
        """Call ``write(path)`` unless the file is intact and was written under the same key.

        Parameters
        ----------
        path : Path
            In OUT.
        key : str
            Hash of all that the file depends on.
        write : callable
            Writes the file, whole or not at all.

        Returns
        -------
        bool
            Whether the file of an earlier run was kept.
        """
        name = path.relative_to(self._workspace.out).as_posix()
        if self._is_intact(name) and self._written[name][0] == key:
            return True
        self._written.pop(name, None)
        write(path)
        self._written[name] = [key, file_sha256(path)]
        return False

    def are_intact(self) -> bool:
        """Whether every file of the record is in OUT as it was written."""
        return bool(self._written) and all(self._is_intact(name) for name in self._written)

    def finish(self, keep: Iterable[Path]) -> None:
        """Save the record, with the files `keep` only: those that the last run wrote or kept."""
        names = {path.relative_to(self._workspace.out).as_posix() for path in keep}
        entries = {name: self._written[name] for name in sorted(names)}
        write_text(self._workspace.written, json.dumps(entries, indent=1) + "\n")

    def _is_intact(self, name: str) -> bool:
        try:
            return file_sha256(self._workspace.out / name) == self._written[name][1]
        except (OSError, LookupError):
            return False

"""Comparison of files with the hashes that a run saved."""

from __future__ import annotations

from pathlib import Path

from modalcam.errors import InputError
from modalcam.names import shown
from modalcam.storage.output_folder import Outputs, Workspace, stays_below
from modalcam.storage.provenance import recording_sha256


def changed_files(out: Path) -> tuple[int, list[str]]:
    """Number of files that the run in OUT recorded, and a sentence for each that is missing or has changed.

    InputError if OUT holds no run.
    """
    workspace = Workspace(out)
    workspace.read_state()
    files = Outputs(workspace).intact()
    if not files:
        where = shown(str(out))
        msg = f"{where}: holds no record of its files; write them again with `modalcam report {where}`"
        raise InputError(msg)
    changed = [name for name, unchanged in files.items() if not unchanged]
    return len(files), [_sentence(out / name, name) for name in changed]


def changed_recordings(out: Path, folder: Path) -> tuple[int, list[str]]:
    """As `changed_files`, of the recordings of the run that are in `folder`."""
    sources = [source for source in Workspace(out).read_record().sources if source.sha256]
    changed = []
    for source in sources:
        path = folder / source.file
        try:
            unchanged = _is_readable(path, source.file) and recording_sha256(path) == source.sha256
        except OSError:
            unchanged = False
        if not unchanged:
            changed.append(_sentence(path, source.file))
    return len(sources), changed


def _is_readable(path: Path, name: str) -> bool:
    """Whether a name that OUT gives is that of a file, or a folder of images, below the folder of the recordings."""
    return stays_below(name) and (path.is_file() or path.is_dir())


def _sentence(path: Path, name: str) -> str:
    return f"{shown(name)}: {'changed since the run' if path.exists() else 'missing'}"

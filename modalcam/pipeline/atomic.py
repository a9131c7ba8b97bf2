"""Atomic writing: a file is written under a temporary name and renamed when it is complete. Reading of such JSON."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from modalcam.common import InputError, OutputError, readable_bytes, shown

# More than a run of 10^5 recordings writes.
_MOST_BYTES = 500_000_000
_PARTIAL = re.compile(r"\.tmp-\d+-.")


def temporary_name(path: Path) -> Path:
    """Path beside `path` for a file of this process that `remove_partial` may remove after it was killed."""
    return path.with_name(f".tmp-{os.getpid()}-{path.name}")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Temporary path that becomes `path` if the block ends without an error.

    The data are on disk before the rename. After an error the partial file is removed and `path` is unchanged.
    OutputError where the medium is full or cannot be written.
    """
    # The suffix is kept: writers such as those of HDF5 and PNG choose the format by it.
    temporary = temporary_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        if error.filename is not None and Path(error.filename) not in (path, path.parent, temporary):
            raise
        msg = f"{shown(str(path))}: cannot be written ({error.strerror or error})"
        raise OutputError(msg) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_partial(folder: Path) -> None:
    """Remove files with a temporary name below a folder, left by a killed process; nothing else may write there."""
    for path in folder.rglob(".tmp-*"):
        if _PARTIAL.match(path.name) and path.is_file():
            with suppress(OSError):
                path.unlink()


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text with Unix line ends, completely or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(text.encode("utf-8", "backslashreplace"))


def write_json(path: Path, value: object) -> None:
    """Write JSON, completely or not at all."""
    write_text(path, json.dumps(value, indent=1, allow_nan=False) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """The object of a JSON file in a folder that anybody may have filled.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        For anything else that is not a regular file of modest size with one object.
    """
    if not path.exists():
        raise FileNotFoundError(path)
    try:
        readable_bytes(path, _MOST_BYTES)
        value = json.loads(path.read_text("utf-8"))
    except (InputError, RecursionError) as error:
        raise ValueError(str(error)) from error
    if not isinstance(value, dict):
        msg = f"expected an object, found {type(value).__name__}"
        raise ValueError(msg)  # noqa: TRY004 - the content is wrong, not the type of an argument
    return value

"""The user's files: which may be read at all, and which may be written."""

from __future__ import annotations

import logging
import os
import stat
import tokenize
from pathlib import Path

from modalcam.errors import InputError, OutputError
from modalcam.names import shown

# What NumPy raises for an array's header that it cannot use: the header is an expression in Python, which it parses.
ARRAY_DAMAGE = (
    EOFError,
    OverflowError,
    ValueError,
    TypeError,
    SyntaxError,
    tokenize.TokenError,
    RecursionError,
)


def silence_readers() -> None:
    """Keep the log of libraries off the terminal: what matters to the user is in the message or the notes."""
    logger = logging.getLogger("tifffile")
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())


def real(path: Path) -> Path:
    """Absolute path without links; a link to itself stays as it is.

    `Path.resolve` raises RuntimeError for such a link before Python 3.13.
    """
    return Path(os.path.realpath(path))


def readable_bytes(path: Path, most: int) -> int:
    """Size of a regular file of at most `most` bytes; InputError for any other.

    Nothing is opened: a pipe would block, and a device may never end.
    """
    try:
        status = path.stat()
    except OSError as error:
        msg = f"{shown(str(path))}: cannot be read ({error.strerror})"
        raise InputError(msg) from error
    except ValueError:
        msg = f"{shown(str(path))}: expected the name of a file, found one with a null character"
        raise InputError(msg) from None
    if not stat.S_ISREG(status.st_mode):
        msg = f"{shown(str(path))}: expected a regular file, found a folder, a pipe or a device"
        raise InputError(msg)
    if status.st_size > most:
        msg = f"{shown(str(path))}: expected at most {most} bytes, found {status.st_size}"
        raise InputError(msg)
    return status.st_size


def check_new(path: Path, *, force: bool = False) -> None:
    """Refuse to write over a file, unless `force` is set."""
    if path == Path("-"):
        msg = "-: expected the name of a file; nothing is written to standard output"
        raise OutputError(msg)
    if path.exists() and not (force and path.is_file()):
        what = "exists already; give another file, or --force to replace it"
        msg = (
            f"{shown(str(path))}: {what if path.is_file() else 'expected the name of a file, found a folder'}"
        )
        raise OutputError(msg)

"""What every part of the program needs: names and texts made safe, expected errors, checks of the user's files."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import stat
import tokenize
import unicodedata
from collections import Counter
from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path, PurePath

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
_RESERVED = re.compile(r"^(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)
_MAX_LENGTH = 80


def recording_names(files: Sequence[str]) -> tuple[str, ...]:
    """A name for each file (paths relative to the folder, POSIX separators).

    The stem if it is safe and no other file shares it (ignoring case and Unicode form), otherwise the safe part of the
    whole path and 8 hex digits of its hash. The names depend on the set of files, not on their order.
    """
    stems = [PurePath(file).stem for file in files]
    count = Counter(_fold(stem) for stem in stems)
    return tuple(
        stem if count[_fold(stem)] == 1 and _is_safe(stem) else _hashed(file)
        for file, stem in zip(files, stems, strict=True)
    )


def escape(character: str) -> str:
    """Its code, after a backslash, for a character that would not be seen."""
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def shown(text: str) -> str:
    """Text with control characters, direction marks and undecodable bytes made visible."""
    # None of these is printable, and images in a page are megabytes of plain letters.
    if text.isprintable():
        return text
    hidden = ("Cc", "Cf", "Cs", "Zl", "Zp")
    return "".join(escape(c) if c == "\xa0" or unicodedata.category(c) in hidden else c for c in text)


def for_terminal(text: str) -> str:
    """Text of one or more lines, each as `shown`: a name or a value from a file may hold escape sequences."""
    return "\n".join(shown(line) for line in text.split("\n"))


def csv_safe(text: str) -> str:
    """Text that a spreadsheet does not evaluate: preceded by ``'`` if it begins like a formula."""
    visible = shown(text)
    return f"'{visible}" if visible[:1] in ("=", "+", "-", "@") else visible


def natural_key(text: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key that puts frame2 before frame10."""
    parts = re.split(r"(\d+)", text)
    return (*((0, int(p), "") if p.isdecimal() else (1, 0, p) for p in parts), (2, 0, text))


def _fold(text: str) -> str:
    return unicodedata.normalize("NFKC", text).casefold()


def _is_safe(stem: str) -> bool:
    return (
        0 < len(stem) <= _MAX_LENGTH
        and _UNSAFE.search(stem) is None
        and stem[0] not in ".-"
        and _RESERVED.match(stem) is None
    )


def _hashed(file: str) -> str:
    try:
        # The bytes on disk: Python decodes them differently in a locale without UTF-8.
        name = os.fsencode(file)
    except UnicodeEncodeError:
        name = file.encode("utf-8", "surrogatepass")
    digest = hashlib.sha256(name).hexdigest()[:8]
    safe = _UNSAFE.sub("_", file).strip("._-")[: _MAX_LENGTH - 9]
    return f"{safe}-{digest}" if safe else f"recording-{digest}"


class ExitCode(IntEnum):
    """Exit codes of the program."""

    OK = 0
    INTERNAL = 1
    USAGE = 2
    NO_INPUT = 3
    PARTIAL = 4
    INTERRUPTED = 130
    CLOSED_OUTPUT = 141


class ModalcamError(Exception):
    """An expected error: its text states what was expected, what was found, where, and what to do."""

    exit_code = ExitCode.USAGE


class ConfigError(ModalcamError):
    """A configuration that cannot be used."""


class InputError(ModalcamError):
    """Input that cannot be used at all."""


class OutputError(ModalcamError):
    """Results that cannot be written."""


class NoInputError(ModalcamError):
    """No recording was found."""

    exit_code = ExitCode.NO_INPUT


class TrackingError(ModalcamError):
    """A recording that could not be tracked; the text gives the reason and a remedy."""


class IdentificationError(ModalcamError):
    """A series without an identifiable mode; the text gives the reason and a remedy."""


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

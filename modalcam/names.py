"""Names of recordings: unique and safe as file names; names and texts made safe to show."""

from __future__ import annotations

import hashlib
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from pathlib import PurePath

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


def shown(text: str) -> str:
    """Text with control characters, direction marks and undecodable bytes made visible."""
    # None of these is printable, and images in a page are megabytes of plain letters.
    if text.isprintable():
        return text
    return "".join(
        f"\\x{ord(c):02x}"
        if ord(c) < 0x100 and not c.isprintable()
        else f"\\u{ord(c):04x}"
        if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp")
        else c
        for c in text
    )


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

"""Fetch the real recordings that tests read: ``python -m tests.realdata``.

``realdata.tsv`` names each file with its licence, size, SHA-256 and published source. The files go into ``realdata`` in
the repository, which git ignores, or into the folder that MODALCAM_REALDATA names. Those that are there already, whole,
are kept; a file whose hash differs is not written.
"""

import csv
import hashlib
import os
import sys
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = Path(__file__).with_suffix(".tsv")
FOLDER = Path(os.environ.get("MODALCAM_REALDATA") or ROOT / "realdata")
_TIMEOUT_S = 60


@dataclass(frozen=True)
class Entry:
    """One file: its path below the folder, size in bytes, hash, licence and source."""

    file: str
    licence: str
    size: int
    sha256: str
    source: str


def entries(table=TABLE):
    """All files of a table."""
    with table.open(newline="", encoding="utf-8") as rows:
        return [
            Entry(row["file"], row["licence"], int(row["bytes"]), row["sha256"], row["source"])
            for row in csv.DictReader(rows, delimiter="\t")
        ]


def is_whole(entry, folder):
    """Whether the file is there with the hash of the table."""
    path = folder / entry.file
    return path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == entry.sha256


def fetch(entry, folder):
    """Write one file, under another name until it is whole; returns the reason where that failed."""
    if not entry.source.startswith(("https://", "http://127.0.0.1:")):
        return entry.source
    try:
        with urllib.request.urlopen(entry.source, timeout=_TIMEOUT_S) as response:  # noqa: S310 - of the table
            content = response.read(entry.size + 1)
    except (urllib.error.URLError, TimeoutError) as error:
        return f"{entry.source}: {error}"
    found = hashlib.sha256(content).hexdigest()
    if found != entry.sha256:
        return f"{entry.source}: expected {entry.size} bytes of SHA-256 {entry.sha256}, found {found}; not written"
    path = folder / entry.file
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(content)
    partial.replace(path)
    return None


def main(table=TABLE, folder=FOLDER):
    """Fetch what is missing; exit status 1 where a file is still missing afterwards."""
    missing = [entry for entry in entries(table) if not is_whole(entry, folder)]
    failed = 0
    for number, entry in enumerate(missing, 1):
        reason = fetch(entry, folder)
        failed += reason is not None
        sys.stdout.write(f"{number} of {len(missing)}: {entry.file} ({entry.licence})\n")
        if reason is not None:
            sys.stdout.write(f"    missing: {reason}\n")
    sys.stdout.write(f"{folder}: {len(entries(table)) - failed} of {len(entries(table))} files\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

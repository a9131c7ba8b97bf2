"""What a finished run found: a table of its modes, and why recordings gave none."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from modalcam.console import mode_cells
from tracker import Failure

MODE_COLUMNS = ("recording", "mode", "frequency / Hz", "damping ratio / %", "90 % interval / %", "flags")


@dataclass(frozen=True)
class RunResults:
    """Rows of the table, and (file, reason) of each recording without a result."""

    rows: tuple[tuple[str, ...], ...]
    failures: tuple[tuple[str, str], ...]


def run_results(summary: Path) -> RunResults | Failure:
    """Read them from ``summary.json``."""
    try:
        found = json.loads(summary.read_text("utf-8"))
        recordings, config = found["recordings"], found["config"]
        cells = [(motion, row) for recording in recordings for motion, row in mode_cells(recording, config)]
        rows = tuple((*row, ", ".join(motion["flags"])) for motion, row in cells)
        reasons = ((one["file"], one["failure"] or _no_target(one["failed_modes"])) for one in recordings)
        # The message of a reader starts with the file's name.
        failures = tuple((file, reason.removeprefix(f"{file}: ")) for file, reason in reasons if reason)
        return RunResults(rows, failures)
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        return Failure(f"summary.json of the run cannot be read: {error!r}")


def _no_target(failed: list[dict[str, object]]) -> str:
    return next((str(mode["reason"]) for mode in failed if mode["target"]), "")

"""`truth.json` of a folder of synthetic recordings: what was simulated."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

TRUTH_NAME = "truth.json"


@dataclass(frozen=True)
class TrueMode:
    """Frequency at small amplitude and damping ratio that a recording was simulated with."""

    frequency_hz: float
    damping_ratio: float


@dataclass(frozen=True)
class Truth:
    """What a folder says was simulated, by mode number; `note` says why there is nothing where a file is of no use."""

    modes: dict[int, TrueMode]
    note: str = ""

    def __bool__(self) -> bool:
        return bool(self.modes)


def read_truth(folder: Path) -> Truth:
    """Truth of the recordings in `folder`: nothing, and no note, where there is no such file."""
    path = folder / TRUTH_NAME
    try:
        entries = json.loads(path.read_text("utf-8"))["recordings"]
        modes = {
            int(entry["mode"]): TrueMode(float(entry["frequency_hz"]), float(entry["damping_ratio"]))
            for entry in entries
        }
    except FileNotFoundError:
        return Truth({})
    except (OSError, ValueError, KeyError, TypeError) as error:
        # Measurements stand without it, so that it is no reason to stop.
        note = (
            f"{TRUTH_NAME} was not used: expected a list of recordings, each with mode, frequency_hz and "
            f"damping_ratio; found {type(error).__name__}: {error}."
        )
        return Truth({}, note)
    return Truth(modes)

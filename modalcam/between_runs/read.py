"""Modes of finished runs, from `summary.json`: results of other versions of modalcam can be compared, too."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from modalcam.errors import InputError
from modalcam.files import readable_bytes
from modalcam.names import shown
from modalcam.storage import Workspace

_MOST_BYTES = 500_000_000
# Modes of one number in different runs, and those without a number, differ by less than this.
_SAME_FREQUENCY = 0.05


@dataclass(frozen=True)
class RunMode:
    """A mode that was excited in one recording of one run.

    `frequency_sd_hz` does not include the error of the clock, `clock_sd_hz`, which the recordings of a run share.
    `number` is None where it is unknown, and `sha256`, of the recording, empty.
    """

    run: str
    recording: str
    number: int | None
    frequency_hz: float
    frequency_sd_hz: float
    clock_sd_hz: float
    damping_ratio: float
    damping_ratio_sd: float
    amplitude: float
    amplitude_unit: str
    flags: tuple[str, ...]
    sha256: str = ""


def run_modes(out: Path, label: str, *, small_amplitude: bool = False) -> tuple[RunMode, ...]:
    """Modes of a run at the amplitudes of its recordings or at small amplitude.

    InputError if `out` does not hold a run with a mode.
    """
    path = Workspace(out).summary
    readable_bytes(path, _MOST_BYTES)
    try:
        tree = json.loads(path.read_text("utf-8"))
        clocks = [(budget["recording"], budget["clock_hz"]) for budget in tree["uncertainty"]]
        # Budgets stand in the order of the modes.
        modes = [(recording, mode) for recording in tree["recordings"] for mode in recording["modes"]]
        at = "small_amplitude_" if small_amplitude else ""
        found = [
            replace(
                _mode(label, recording["recording"], mode, clock, at), sha256=str(recording.get("sha256", ""))
            )
            for (recording, mode), (_, clock) in zip(modes, clocks, strict=True)
            if mode["target"]
        ]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        msg = f"{shown(str(path))}: expected values and standard deviations of the modes of a run; run again"
        raise InputError(msg) from error
    if not found:
        msg = f"{shown(str(out))}: expected a run with identified modes, found none; see its report"
        raise InputError(msg)
    return tuple(found)


def _mode(run: str, recording: str, mode: dict[str, Any], clock_hz: float, at: str) -> RunMode:
    """The mode with its values named by `at`; ValueError where they cannot be compared."""
    total = float(mode[f"frequency_{at}sd_hz"])
    found = RunMode(
        run,
        str(recording),
        None if mode["mode"] is None else int(mode["mode"]),
        float(mode[f"frequency_{at}hz"]),
        # Above zero where rounding would leave nothing.
        float(np.sqrt(max(total**2 - clock_hz**2, 1e-6 * total**2))),
        float(clock_hz),
        float(mode[f"damping_ratio_{at}".rstrip("_")]),
        float(mode[f"damping_ratio_{at}sd"]),
        float(mode["amplitude"]),
        str(mode["amplitude_unit"]),
        tuple(map(str, mode["flags"])),
    )
    values = (found.frequency_hz, found.frequency_sd_hz, found.damping_ratio_sd)
    if not np.isfinite(found.damping_ratio) or not all(0.0 < value < np.inf for value in values):
        raise ValueError
    return found


def same_modes(modes: list[RunMode]) -> list[tuple[RunMode, ...]]:
    """Modes grouped by their number, those without one with the nearest within 5 %; by frequency."""
    groups: list[list[RunMode]] = []
    for mode in sorted(modes, key=lambda m: (m.number is None, m.number or 0, m.frequency_hz)):
        distance = [abs(np.log(mode.frequency_hz / np.mean([m.frequency_hz for m in g]))) for g in groups]
        fits = [
            k
            for k, group in enumerate(groups)
            if (mode.number == group[0].number if mode.number is not None else distance[k] < _SAME_FREQUENCY)
        ]
        if fits:
            groups[min(fits, key=lambda k: distance[k])].append(mode)
        else:
            groups.append([mode])
    return sorted(map(tuple, groups), key=lambda group: group[0].frequency_hz)

"""Damping that a run measured, as a deck needs it: modes with numbers and intervals, and a Rayleigh fit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from modal_id import DrivenMotion, Identification, IdentifiedMode, ModeFlag
from modalcam.common import InputError
from modalcam.pipeline import MeasuredMode, RecordingResult, RunResult, measured_modes
from sim.damping import MeasuredDamping, RayleighDamping, rayleigh_to_all
from tracker import INTERVAL_SD, Severity


@dataclass(frozen=True)
class DampedMode:
    """A measured mode.

    Attributes
    ----------
    number : int
        From 1, counted among the bending modes in the filmed plane.
    frequency_hz : float
        Natural frequency; at small amplitude where it depends on the amplitude.
    damping_ratio : float
        Fraction of critical damping, at the amplitudes of the recordings.
    low, high : float
        90 % interval of `damping_ratio`.
    remarks : tuple of str
        Flags and what they mean for the value.
    frequency_sd_hz, damping_ratio_sd : float
        Standard deviations, with the error of the frame rate and the scatter between recordings; NaN where unknown.
    """

    number: int
    frequency_hz: float
    damping_ratio: float
    low: float
    high: float
    remarks: tuple[str, ...] = ()
    frequency_sd_hz: float = float("nan")
    damping_ratio_sd: float = float("nan")


@dataclass(frozen=True)
class Damping:
    """Measured damping of a beam.

    Attributes
    ----------
    modes : tuple of DampedMode
        In order of number, at least one.
    left_out : tuple of str
        Modes of the run that a deck does not use, with the reasons.
    provenance : tuple of str
        Run, versions and recordings, a line each.
    """

    modes: tuple[DampedMode, ...]
    left_out: tuple[str, ...] = ()
    provenance: tuple[str, ...] = ()

    @property
    def rayleigh(self) -> RayleighDamping | None:
        """Alpha and beta, at least 0, by least squares over all damping ratios; None for a single mode."""
        if len(self.modes) < 2:
            return None
        return rayleigh_to_all(
            MeasuredDamping(
                tuple(mode.number for mode in self.modes),
                tuple(mode.frequency_hz for mode in self.modes),
                tuple(mode.damping_ratio for mode in self.modes),
            )
        )

    @property
    def between(self) -> tuple[int, ...]:
        """Numbers up to the highest measured mode that were not measured."""
        measured = {mode.number for mode in self.modes}
        return tuple(number for number in range(1, max(measured) + 1) if number not in measured)

    def ratios(self) -> tuple[float, ...]:
        """Damping ratios of modes 1 to the highest measured one, for codes that count modes.

        A mode that was not measured has the ratio interpolated over the number, below the lowest that of the lowest.
        """
        numbers = [mode.number for mode in self.modes]
        found = np.interp(range(1, numbers[-1] + 1), numbers, [mode.damping_ratio for mode in self.modes])
        return tuple(map(float, found))

    def table(self) -> tuple[tuple[float, float], ...]:
        """Frequency in Hz and damping ratio of the measured modes, in order of frequency."""
        return tuple(sorted((mode.frequency_hz, mode.damping_ratio) for mode in self.modes))


def damping_of(result: RunResult) -> Damping:
    """Damping of the modes of a run: those of free decays with a number, an interval and no flag of a wrong value.

    Raises
    ------
    InputError
        If there is no such mode; the message has the reason for each.
    """
    usable, left_out = [], []
    for recording in result.recordings:
        found = recording.identified
        if found is None:
            left_out.append(f"{recording.name}: {recording.failure or 'not identified'}")
            continue
        reasons = {id(mode): _reason(found, mode) for mode in found.motions}
        left_out += [
            f"{recording.name}: {_name(m)} ({reasons[id(m)]})" for m in found.motions if reasons[id(m)]
        ]
        modes = tuple(mode for mode in found.modes if not reasons[id(mode)])
        usable.append(replace(recording, identification=replace(found, modes=modes)))
    measured = measured_modes(usable)
    numbers = {mode.number for mode in measured}
    left_out += [
        f"{name}: {_name(mode)} (not excited on purpose; its shape does not confirm the number)"
        for name, mode in _each(usable)
        if mode.number not in numbers
    ]
    if not measured:
        found_instead = "; ".join(left_out) or "no recording"
        msg = (
            f"expected modes of free decays with numbers and intervals, found {found_instead}; see the report"
        )
        raise InputError(msg)
    return Damping(
        tuple(_damped(mode, usable) for mode in measured),
        tuple(left_out),
        tuple(_provenance(result, measured)),
    )


def _each(recordings: list[RecordingResult]) -> Iterator[tuple[str, IdentifiedMode]]:
    for recording in recordings:
        if recording.identified is not None:
            yield from ((recording.name, mode) for mode in recording.identified.modes)


def _reason(found: Identification, mode: IdentifiedMode | DrivenMotion) -> str:
    """Why a deck does not use a mode; empty where it does."""
    if isinstance(mode, DrivenMotion):
        return "driven, which does not show damping"
    if not found.has_decay:
        return "not of a free decay"
    if mode.number is None:
        return "without a mode number"
    wrong = [flag for flag in mode.flags if mode.severity_of(flag) is Severity.WRONG]
    if wrong:
        return f"flagged {', '.join(wrong)}"
    low, high = mode.damping_interval()
    return "" if 0.0 <= low < high < np.inf else "without an interval"


def _name(mode: IdentifiedMode | DrivenMotion) -> str:
    return (
        f"{mode.frequency_hz:.4g} Hz"
        if mode.number is None
        else f"mode {mode.number}, {mode.frequency_hz:.4g} Hz"
    )


def _damped(mode: MeasuredMode, usable: list[RecordingResult]) -> DampedMode:
    of = [(name, m) for name, m in _each(usable) if m.number == mode.number and name in mode.recordings]
    if len(of) == 1:
        low, high = of[0][1].damping_interval()
    else:
        reach = INTERVAL_SD * mode.damping_ratio_sd
        low, high = max(mode.damping_ratio - reach, 0.0), mode.damping_ratio + reach
    remarks = [f"{name}: {flag}{_small(one, flag)}" for name, one in of for flag in one.flags]
    if mode.damping.disagree:
        remarks.append("The recordings disagree; the interval includes their scatter.")
    sds = (mode.frequency_sd_hz, mode.damping_ratio_sd)
    return DampedMode(mode.number, mode.frequency_hz, mode.damping_ratio, low, high, tuple(remarks), *sds)


def _small(mode: IdentifiedMode, flag: str) -> str:
    if flag != ModeFlag.AMPLITUDE_DEPENDENT.name:
        return ""
    value, sd = mode.small_amplitude_damping
    return f", damping ratio at small amplitude {value:.4g} (sd {sd:.2g})"


def _provenance(result: RunResult, measured: tuple[MeasuredMode, ...]) -> Iterator[str]:
    program = dict(result.versions).get("modalcam", "of unknown version")
    yield f"Measured with modalcam {program} in the run of {result.folder}, seed {result.seed}."
    used = {name for mode in measured for name in mode.recordings}
    for recording in result.recordings:
        if recording.name in used:
            yield f"{recording.name}: SHA-256 {recording.sha256[:16] or 'unknown'}..."

"""Displacement, spectrum, parts of the record and modes, of the last run or of a test track, for the decay view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modal_id import (
    FailedIdentification,
    Identification,
    IdentifyOptions,
    IdentifySettings,
    ModeFlag,
    identify,
)
from modal_id.data import FitData
from modal_id.fit import nyquist_hz, stability_diagram
from modal_id.segments import DRIVEN_CHANGE
from modal_id.solve import frequency_hz
from modalcam.config import RecordingConfig
from modalcam.errors import InputError
from modalcam.pipeline import load_recording
from modalcam.storage import Workspace
from modalcam.studio.decoding import Problem
from tracker import DisplacementSeries, FloatArray, MarkerTracks, displacement_series

# Points of a drawn curve: the smallest and the largest of each of half as many parts of the record.
_MOST_POINTS = 3000
# Frequencies of the stabilisation chart, in those of the highest mode.
_ABOVE_HIGHEST = 1.5
_FILES = ("tracks", "modes")
# Reach of a click on the spectrum, as a share of its range.
_CLICK_REACH = 0.01


@dataclass(frozen=True)
class DecayTask:
    """A recording of a finished run, and the channel to show: None for the one that moves most."""

    out: Path
    file: str
    channel: str | None = None


@dataclass(frozen=True)
class FoundMode:
    """A mode of the run: frequency in Hz, damping ratio and its 90 % interval, whether it is the target, its flags.

    The damping ratio is NaN where a test track cannot show it.
    """

    frequency_hz: float
    damping_ratio: float
    interval: tuple[float, float]
    target: bool
    flags: tuple[str, ...]


@dataclass(frozen=True)
class Pole:
    """A pole of a model of some order (number of states), and whether it recurs in successive orders."""

    frequency_hz: float
    order: int
    is_stable: bool


@dataclass(frozen=True)
class Decay:
    """One channel of a recording with what was found in all of them.

    `curve` is (time in s, displacement in `unit`), `spectrum` (frequency in Hz, amplitude in `unit`), `parts` (kind,
    start, end) in s, `poles` the points of the stabilisation chart.
    """

    channels: tuple[str, ...]
    channel: str
    unit: str
    curve: tuple[tuple[float, float], ...]
    spectrum: tuple[tuple[float, float], ...]
    span_s: tuple[float, float]
    parts: tuple[tuple[str, float, float], ...]
    modes: tuple[FoundMode, ...]
    notes: tuple[str, ...]
    poles: tuple[Pole, ...] = ()


@dataclass(frozen=True)
class TrialDecayTask:
    """A test track to be identified as a run would identify the recording, but without the theory of a beam."""

    tracks: MarkerTracks
    recording: RecordingConfig


def identified_trial(task: TrialDecayTask) -> Identification | FailedIdentification:
    """Modes of a test track."""
    try:
        series = displacement_series(task.tracks)
        settings = {name: getattr(task.recording, name) for name in IdentifyOptions.model_fields}
        return identify(series, IdentifySettings(**settings))
    except ValueError as error:
        return FailedIdentification(task.recording.file, str(error))


def decay_of(task: DecayTask) -> Decay | Problem:
    """Read what the run in OUT saved of a recording."""
    workspace = Workspace(task.out)
    try:
        record = workspace.read_record()
        source = next((source for source in record.sources if source.file == task.file), None)
        if source is None:
            return Problem("the last run did not include this recording; run again")
        recording = load_recording(workspace, record, source, _FILES)
    except InputError as error:
        return Problem(str(error))
    found = recording.identification
    if recording.series is None:
        return Problem(recording.failure or "the last run gave no displacements of this recording")
    identified = found if isinstance(found, Identification) else None
    decay = shown_decay(recording.series, identified, task.channel)
    if isinstance(decay, Decay) or identified is not None or found is None:
        return decay
    return Problem(getattr(found, "reason", decay.reason))


def shown_decay(
    series: DisplacementSeries, identified: Identification | None, channel: str | None = None
) -> Decay | Problem:
    """One channel of a series, the one that moves most unless another is named, with what was identified."""
    seen = np.isfinite(series.values)
    if not seen.any():
        return Problem("no marker was followed in any frame")
    sizes = [
        float(np.ptp(series.values[seen[:, k], k])) if seen[:, k].any() else -1.0
        for k in range(seen.shape[1])
    ]
    k = series.channels.index(channel) if channel in series.channels else int(np.argmax(sizes))
    rows = seen[:, k]
    if not rows.any():
        return Problem(f"{series.channels[k]} was not followed in any frame")
    time_s, values = series.time_s[rows], series.values[rows, k]
    modes = (
        ()
        if identified is None
        else tuple(
            FoundMode(m.frequency_hz, m.damping_ratio, m.damping_interval(0.9), m.target, m.flags)
            for m in identified.modes
        )
    )
    parts = () if identified is None else tuple((p.kind, p.start_s, p.end_s) for p in identified.segments)
    failed = () if identified is None else identified.failed
    notes = () if identified is None else identified.notes
    notes += tuple(
        f"{f.frequency_hz:.4g} Hz: {f.reason}" if np.isfinite(f.frequency_hz) else f.reason for f in failed
    )
    return Decay(
        series.channels,
        series.channels[k],
        series.unit,
        thinned(time_s, values),
        thinned(*amplitude_spectrum(time_s, values)),
        (float(series.time_s[0]), float(series.time_s[-1])),
        parts,
        modes,
        notes,
        () if identified is None else stabilisation(identified),
    )


def without_driven(decay: Decay, first: int, last: int, frames: int) -> Decay:
    """What a test track of the frames `first` to `last` of more shows: no damping of a motion that hardly decays there.

    A part of a record that is driven passes for a slow decay where the decay after it is not seen.
    """
    length_s = decay.span_s[1] - decay.span_s[0]
    slow = [
        m for m in decay.modes if 2.0 * np.pi * m.frequency_hz * m.damping_ratio * length_s < DRIVEN_CHANGE
    ]
    nan = float("nan")
    modes = tuple(
        replace(m, damping_ratio=nan, interval=(nan, nan), flags=(*m.flags, ModeFlag.DRIVEN.name))
        if m in slow
        else m
        for m in decay.modes
    )
    notes = tuple(
        f"{m.frequency_hz:.4g} Hz hardly decays in frames {first} to {last} of {frames}: it is driven there, or decays "
        "too slowly for so few frames; track later frames, or all."
        for m in slow
    )
    return replace(decay, modes=modes, notes=(*decay.notes, *notes))


def stabilisation(found: Identification) -> tuple[Pole, ...]:
    """Poles of the subspace check of the fitted decay, up to 1.5 times the highest mode; none without modes."""
    rows = np.flatnonzero(found.used.any(axis=1))
    if not found.modes or len(rows) < 2:
        return ()
    used = found.used[rows][:, found.channels_used]
    values = np.where(used, found.series.values[rows][:, found.channels_used], 0.0)
    baseline = np.where(used, found.baseline[rows][:, found.channels_used], 0.0)
    time_s = found.series.time_s[rows] - found.series.time_s[rows[0]]
    highest_hz = max(mode.frequency_hz for mode in found.modes)
    diagram = stability_diagram(FitData(time_s, values, used.astype(float)), baseline, highest_hz)
    if diagram is None:
        return ()
    return tuple(
        Pole(float(f), order, diagram.confirms(float(f)))
        for order, poles in zip(diagram.orders, diagram.poles, strict=True)
        for f in frequency_hz(poles)
        if f < min(_ABOVE_HIGHEST * highest_hz, nyquist_hz(time_s))
    )


def amplitude_spectrum(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frequencies in Hz and amplitudes of a record with a Hann window; gaps are bridged linearly.

    A steady sine of a frequency of the grid has its amplitude.
    """
    if len(time_s) < 4:
        return np.zeros(1), np.zeros(1)
    step = float(np.median(np.diff(time_s)))
    even = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    signal = np.interp(even, time_s, values)
    window = np.hanning(len(even) + 1)[:-1]
    amplitude = 2.0 * np.abs(np.fft.rfft((signal - signal.mean()) * window)) / window.sum()
    return np.asarray(np.fft.rfftfreq(len(even), step)), np.asarray(amplitude, dtype=np.float64)


def peak_near(spectrum: Sequence[tuple[float, float]], frequency_hz: float) -> float:
    """Frequency of the highest point of a drawn spectrum within a hundredth of its range about a frequency."""
    reach_hz = _CLICK_REACH * (spectrum[-1][0] - spectrum[0][0])
    near = [(amplitude, at_hz) for at_hz, amplitude in spectrum if abs(at_hz - frequency_hz) <= reach_hz]
    return max(near)[1] if near else frequency_hz


def thinned(x: FloatArray, y: FloatArray, most: int = _MOST_POINTS) -> tuple[tuple[float, float], ...]:
    """At most `most` points of a curve: the smallest and the largest value of each part of it."""
    if len(x) > most:
        starts = np.unique(np.linspace(0, len(x), most // 2, endpoint=False).astype(int))
        parts = [*zip(starts, [*starts[1:], len(x)], strict=True)]
        picks = sorted({a + int(pick(y[a:b])) for a, b in parts for pick in (np.argmin, np.argmax)})
        x, y = x[picks], y[picks]
    return tuple((float(a), float(b)) for a, b in zip(x, y, strict=True))

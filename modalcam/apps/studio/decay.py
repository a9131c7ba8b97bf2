"""What the decay view shows, of the last run or of a test track: displacement, spectrum, parts of the record, modes.

The intervals that a run would give are predicted from a test track: its motion is continued and identified as in a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modal_id import (
    Identification,
    IdentifyOptions,
    IdentifySettings,
    ModeFlag,
    identify,
    identify_free_decay,
)
from modal_id.fit import nyquist_hz
from modal_id.segments import may_be_driven, roles_of
from modal_id.solve import frequency_hz, mode_functions, pole
from modalcam.common import InputError
from modalcam.config import RecordingConfig
from modalcam.pipeline import Workspace, load_recording
from modalcam.report import residual, stability_of
from tracker import (
    INTERVAL_SD,
    BoolArray,
    ComplexArray,
    DisplacementSeries,
    Failure,
    FloatArray,
    MarkerTracks,
    displacement_series,
)

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
    start, end) in s, `poles` are the points of the stabilisation chart, `doubts` say which modes were not found or may
    be wrong, and why. `fit` and `residual` are curves like `curve`, NaN where no sample is fitted, and `fitted_s` their
    (start, end) in s; without a fit there is none.
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
    fit: tuple[tuple[float, float], ...] = ()
    residual: tuple[tuple[float, float], ...] = ()
    fitted_s: tuple[float, float] | None = None
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class TrialDecayTask:
    """A test track to be identified as a run would identify the recording, but without the theory of a beam."""

    tracks: MarkerTracks
    recording: RecordingConfig


def identified_trial(task: TrialDecayTask) -> Identification | Failure:
    """Modes of a test track."""
    try:
        series = displacement_series(task.tracks)
        settings = {name: getattr(task.recording, name) for name in IdentifyOptions.model_fields}
        return identify(series, IdentifySettings(**settings))
    except ValueError as error:
        return Failure(str(error), task.recording.file)


def decay_of(task: DecayTask) -> Decay | Failure:
    """Read what the run in OUT saved of a recording."""
    workspace = Workspace(task.out)
    try:
        record = workspace.read_record()
        source = next((source for source in record.sources if source.file == task.file), None)
        if source is None:
            return Failure("the last run did not include this recording; run again")
        recording = load_recording(workspace, record, source, _FILES)
    except InputError as error:
        return Failure(str(error))
    found = recording.identification
    if recording.series is None:
        return Failure(recording.failure or "the last run gave no displacements of this recording")
    identified = found if isinstance(found, Identification) else None
    decay = shown_decay(recording.series, identified, task.channel)
    if isinstance(decay, Decay) or identified is not None or found is None:
        return decay
    return Failure(getattr(found, "reason", decay.reason))


def shown_decay(
    series: DisplacementSeries, identified: Identification | None, channel: str | None = None
) -> Decay | Failure:
    """One channel of a series, the one that moves most unless another is named, with what was identified."""
    seen = np.isfinite(series.values)
    if not seen.any():
        return Failure("no marker was followed in any frame")
    sizes = [
        float(np.ptp(series.values[seen[:, k], k])) if seen[:, k].any() else -1.0
        for k in range(seen.shape[1])
    ]
    k = series.channels.index(channel) if channel in series.channels else int(np.argmax(sizes))
    rows = seen[:, k]
    if not rows.any():
        return Failure(f"{series.channels[k]} was not followed in any frame")
    time_s, values = series.time_s[rows], series.values[rows, k]
    modes = (
        ()
        if identified is None
        else tuple(
            FoundMode(m.frequency_hz, m.damping_ratio, m.damping_interval(), m.target, m.flags)
            for m in identified.modes
        )
    )
    parts = () if identified is None else tuple((p.kind, p.start_s, p.end_s) for p in identified.segments)
    failed = () if identified is None else identified.failed
    doubts = tuple(
        f"{f.frequency_hz:.4g} Hz: {f.reason}" if np.isfinite(f.frequency_hz) else f.reason for f in failed
    )
    decay = Decay(
        series.channels,
        series.channels[k],
        series.unit,
        thinned(time_s, values),
        thinned(*amplitude_spectrum(time_s, values)),
        (float(series.time_s[0]), float(series.time_s[-1])),
        parts,
        modes,
        () if identified is None else identified.notes,
        () if identified is None else stabilisation(identified),
        doubts=doubts,
    )
    return decay if identified is None else _with_fit(decay, identified, k, rows)


def _with_fit(decay: Decay, found: Identification, k: int, rows: BoolArray) -> Decay:
    """The decay with what was fitted to channel `k` at these rows, if anything was."""
    time_s, used = found.series.time_s, found.used[:, k] & np.isfinite(found.fitted[:, k])
    if not used.any():
        return decay
    fit, left = np.where(used, found.fitted[:, k], np.nan)[rows], residual(found)[rows, k]
    return replace(
        decay,
        fit=thinned(time_s[rows], fit),
        residual=thinned(time_s[rows], left),
        fitted_s=(float(time_s[used][0]), float(time_s[used][-1])),
    )


def without_driven(decay: Decay, first: int, last: int, frames: int) -> Decay:
    """What a test track of the frames `first` to `last` of more shows: no damping of a motion that hardly decays there.

    A part of a record that is driven passes for a slow decay where the decay after it is not seen.
    """
    length_s = decay.span_s[1] - decay.span_s[0]
    slow = [m for m in decay.modes if may_be_driven(_drive_probability(m, length_s))]
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
    return replace(decay, modes=modes, doubts=(*decay.doubts, *notes))


def _drive_probability(mode: FoundMode, length_s: float) -> float:
    radians = 2.0 * np.pi * mode.frequency_hz * length_s
    # the sd of a normal density with this 90 % interval
    sd = (mode.interval[1] - mode.interval[0]) / (2.0 * INTERVAL_SD)
    return roles_of(mode.damping_ratio * radians, sd * radians, radians).driven


def stabilisation(found: Identification) -> tuple[Pole, ...]:
    """Poles of the subspace check of the fitted decay, up to 1.5 times the highest mode; none without modes."""
    diagram = stability_of(found)
    if diagram is None:
        return ()
    highest_hz = _ABOVE_HIGHEST * max(mode.frequency_hz for mode in found.modes)
    return tuple(
        Pole(float(f), order, diagram.confirms(float(f)))
        for order, poles in zip(diagram.orders, diagram.poles, strict=True)
        for f in frequency_hz(poles)
        if f < min(highest_hz, nyquist_hz(found.series.time_s[found.used.any(axis=1)]))
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


# Damping is not known before the run: a steel strip, a bolted joint, a lossy one.
USUAL_DAMPING_RATIOS = (0.001, 0.003, 0.01)


@dataclass(frozen=True)
class Tuning:
    """What a test track must show for a prediction."""

    #: [cycles] motion of a shorter track is not told from drift
    cycles: float = 3.0
    #: [sd] a smaller amplitude is noise
    #: statistics: A normal error exceeds it in 6e-7 of cases.
    significance: float = 5.0


TUNING = Tuning()


@dataclass(frozen=True)
class ExpectedTask:
    """Test track of a recording of `frames` frames, and the damping ratios to assume."""

    tracks: MarkerTracks
    frames: int
    damping_ratios: tuple[float, ...] = USUAL_DAMPING_RATIOS


@dataclass(frozen=True)
class Expected:
    """Half widths of the 90 % intervals of frequency in Hz and damping ratio, if the latter is `damping_ratio`."""

    damping_ratio: float
    frequency_hz: float
    damping: float


@dataclass(frozen=True)
class ExpectedIntervals:
    """Strongest line of a test track, its largest amplitude, and what a decay of `seconds` from there on would give."""

    frequency_hz: float
    amplitude_px: float
    seconds: float
    rows: tuple[Expected, ...]


def expected_intervals(task: ExpectedTask) -> ExpectedIntervals | Failure:
    """Predict the intervals of a recording from the track of its beginning.

    Notes
    -----
    The motion of the strongest line is continued as a free decay to the end of the record, with white noise of the
    standard deviations of the test track, and identified with the errors of positions that compression and template
    cause in a run (`tracker.position_errors`). Other modes and amplitude-dependent damping widen the interval further.
    """
    if task.tracks.time_axis.is_playback_guess:
        return Failure("the recorded rate is not known; type it under Recordings, and track again")
    try:
        series = displacement_series(replace(task.tracks, scale=None, plane=None), unit="px")
    except ValueError as error:
        return Failure(str(error))
    usable = np.isfinite(series.sd).any(axis=0) & (np.isfinite(series.values).sum(axis=0) > 8)
    if not usable.any():
        return Failure("no marker was followed in enough frames")
    # Channels without samples are left out, as in a run.
    series = replace(series, values=np.where(usable, series.values, np.nan))
    sd = _typical_sd(series)
    spread = [float(np.ptp(v[np.isfinite(v)])) if np.isfinite(v).any() else -1.0 for v in series.values.T]
    strongest = int(np.argmax(spread))
    seen = np.isfinite(series.values[:, strongest])
    frequency = line_hz(series.time_s[seen], series.values[seen, strongest])
    if frequency * float(np.ptp(series.time_s)) < TUNING.cycles:
        return Failure("the test track is shorter than three cycles of the motion; follow more frames")
    steady = np.abs(_amplitudes(series, pole(2.0 * np.pi * frequency, 0.0)))
    if np.nanmax(steady / sd) * np.sqrt(0.5 * seen.sum()) < TUNING.significance:
        return Failure("no oscillation rises above the noise in these frames; the decay may begin later")
    step_s = float(np.median(np.diff(series.time_s)))
    time_s = np.asarray(np.arange(max(task.frames, series.time_s.size)) * step_s, dtype=np.float64)
    found = [_expected(series, time_s, frequency, zeta) for zeta in task.damping_ratios]
    rows = tuple(one for one in found if isinstance(one, Expected))
    if not rows:
        return next(one for one in found if isinstance(one, Failure))
    return ExpectedIntervals(frequency, float(np.nanmax(steady)), time_s.size * step_s, rows)


def line_hz(time_s: FloatArray, values: FloatArray) -> float:
    """Frequency of the strongest line, between the bins of the spectrum by a parabola through the logarithms."""
    frequency_hz, amplitude = amplitude_spectrum(time_s, values)
    peak = int(np.argmax(amplitude))
    if not 0 < peak < len(amplitude) - 1:
        return float(frequency_hz[peak])
    low, mid, high = np.log(np.maximum(amplitude[peak - 1 : peak + 2], 1e-300))
    shift = 0.5 * (low - high) / (low - 2.0 * mid + high) if low + high < 2.0 * mid else 0.0
    return float(frequency_hz[peak] + shift * (frequency_hz[1] - frequency_hz[0]))


def _typical_sd(series: DisplacementSeries) -> FloatArray:
    """Median standard deviation of each channel; NaN where it has no position."""
    return np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in series.sd.T])


def _amplitudes(series: DisplacementSeries, rate_per_s: ComplexArray) -> ComplexArray:
    """Complex amplitude of each channel at the first frame for a pole, beside offset and drift; least squares."""
    time_s = series.time_s - series.time_s[0]
    wave = mode_functions(time_s, np.atleast_1d(rate_per_s))[:, 0]
    basis = np.column_stack([wave.real, -wave.imag, np.ones_like(time_s), time_s])
    found = np.full(len(series.channels), complex(np.nan, np.nan))
    for k, column in enumerate(series.values.T):
        seen = np.isfinite(column)
        if seen.any():
            cosine, sine, *_ = np.linalg.lstsq(basis[seen], column[seen], rcond=None)[0]
            found[k] = complex(cosine, sine)
    return found


def _expected(
    series: DisplacementSeries, time_s: FloatArray, frequency_hz: float, damping_ratio: float
) -> Expected | Failure:
    """Intervals of the decay that the test track begins, for one damping ratio."""
    rate_per_s = np.atleast_1d(pole(2.0 * np.pi * frequency_hz, damping_ratio))
    motion = np.real(mode_functions(time_s, rate_per_s) * _amplitudes(series, rate_per_s))
    sd = np.broadcast_to(_typical_sd(series), motion.shape)
    noise = np.random.default_rng(0).normal(size=motion.shape)
    decay = replace(
        series, time_s=time_s, values=motion + sd * noise, sd=sd, base=None, base_sd=None, scale_change=None
    )
    settings = IdentifySettings(target_frequency_hz=frequency_hz, max_modes=1)
    found = identify_free_decay(decay, settings)
    mode = found.target if isinstance(found, Identification) else None
    if mode is None:
        return Failure("the noise hides the decay; follow a point that moves more or has more contrast")
    slow, fast = mode.frequency_interval_hz()
    low, high = mode.damping_interval()
    return Expected(damping_ratio, 0.5 * (fast - slow), 0.5 * (high - low))

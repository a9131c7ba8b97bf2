"""Direction of the vibration of tracked markers, whatever else they do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from tracker.arrays import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Lines of the spectrum, and slow ones that may be the camera."""

    #: [bins] whose median is the level of the spectrum
    neighbours: int = 101
    #: [1] a line exceeds that level by this factor in power
    #: statistics: a bin of noise exceeds it by up to about ten
    line: float = 30.0
    #: [frames] without which the direction is that of the largest variance, and no change of the scale is seen
    least_frames: int = 64
    #: [bins] up to which a drift without a period reaches
    #: physics: twice the half width of the main lobe of the window
    drift_bins: float = 4.0
    #: [Hz] slower motion may be that of the camera
    #: convention: it is left to the baseline (`modal_id.data.baseline`)
    ceiling_hz: float = 1.0
    #: [1] power of the share of that frequency by which slower amplitudes count less
    #: physics: 8 px at 0.5 Hz count like 0.12 px, less than the 0.3 px of a decay from 2.9 px at 10 Hz with 0.5 % of
    #: damping under the window of 20 s
    order: int = 6


TUNING = Tuning()


def vibration_direction(centred: FloatArray, frame_s: float | None = None) -> FloatArray:
    """Unit vector, shape (2,), of the largest power in the lines of the spectrum; its larger component is positive.

    Drift and jumps of markers, which have no lines, may exceed the vibration and lie across it: a patch slides along an
    edge, a camera moves. Slow lines count less, as camera motion. Without any line, the direction is that of the
    largest variance.

    Parameters
    ----------
    centred : array, shape (2, n, m)
        x and y of m markers in n frames about their means; NaN where unknown.
    frame_s : float or None
        Time between frames in s; where None, only drift of a few cycles in the record is slow.
    """
    known = np.isfinite(centred).all(axis=0)
    if not known.any():
        return np.array([1.0, 0.0])
    filled = np.where(known, centred, 0.0)
    if centred.shape[1] >= TUNING.least_frames:
        power = _power(filled)
        lines = _lines(_largest(power))
        if np.any(lines):
            slow = np.arange(lines.size) < _slowest(centred.shape[1], frame_s)
            vector = _principal(np.sum((power * _share(centred.shape[1], frame_s))[:, :, lines], axis=2))
            # Nothing slow lies across it: slow lines, too, are the vibration.
            if not np.any(_lines(_across(power, vector))[slow]):
                vector = _principal(np.sum(power[:, :, lines], axis=2))
            return vector
    return _principal(np.einsum("inm,jnm->ij", filled, filled))


def _principal(moment: FloatArray) -> FloatArray:
    """Unit vector of the largest of these second moments, shape (2, 2)."""
    vector = np.linalg.eigh(moment)[1][:, 1]
    return np.asarray(vector if vector[np.argmax(np.abs(vector))] > 0 else -vector)


def stronger_across(centred: FloatArray, direction: FloatArray, frame_s: float) -> tuple[str, ...]:
    """A note where the largest line across the direction exceeds the largest along it; empty where none does.

    Parameters as for `vibration_direction`; a drift without a period counts as the slowest line of the record.
    """
    filled = np.where(np.isfinite(centred).all(axis=0), centred, 0.0)
    if filled.shape[1] < TUNING.least_frames:
        return ()
    power = _power(filled)
    lines = np.flatnonzero(_lines(_largest(power)))
    if not lines.size:
        return ()
    along, across = (_across(power[:, :, lines], v) for v in (_turned(direction), direction))
    if across.max() <= along.max():
        return ()
    used, left = lines[np.argmax(along)], lines[np.argmax(across)]
    record_s = filled.shape[1] * frame_s
    slow = left < _slowest(filled.shape[1], frame_s)
    advice = (
        "It is slow and taken for motion of the camera: fix the camera, or add a reference marker on a fixed point."
        if slow
        else "If that is the vibration you mean, give its `direction` to `modalcam.displacement`."
    )
    note = (
        f"Across the direction used the markers move more: at about {left / record_s:.2g} Hz "
        f"{np.sqrt(across.max() / along.max()):.2g} times as much as along it at {used / record_s:.4g} Hz. {advice}"
    )
    return (note,)


def strongest_line_hz(displacements: FloatArray, frame_s: float) -> float:
    """Frequency at which displacements, shape (n, m), are largest, slow motion counting less; NaN counts as 0."""
    frames = displacements.shape[0]
    spectra = np.fft.rfft(np.nan_to_num(displacements) * np.hanning(frames)[:, None], axis=0)
    power = np.sum(np.abs(spectra) ** 2, axis=1) * _share(frames, frame_s)
    return float(int(np.argmax(power)) / (frames * frame_s))


def component(direction: FloatArray, xy: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Component along a unit vector, and its standard deviation.

    The first axis is x and y, and that of the variances also their covariance.
    """
    values = direction[0] * xy[0] + direction[1] * xy[1]
    squared = direction[0] ** 2 * variance[0] + direction[1] ** 2 * variance[1]
    squared = squared + 2.0 * direction[0] * direction[1] * variance[2]
    return values, np.sqrt(np.maximum(squared, 0.0))


def _share(frames: int, frame_s: float | None) -> FloatArray:
    """Share of the power in each bin that counts; shape (bins,)."""
    return np.asarray(
        np.minimum(np.arange(frames // 2 + 1) / _slowest(frames, frame_s), 1.0) ** (2 * TUNING.order)
    )


def _slowest(frames: int, frame_s: float | None) -> float:
    """Bin of the slowest line that counts fully."""
    return max(TUNING.drift_bins, 0.0 if frame_s is None else TUNING.ceiling_hz * frames * frame_s)


def _turned(direction: FloatArray) -> FloatArray:
    return np.array([-direction[1], direction[0]])


def _across(power: FloatArray, direction: FloatArray) -> FloatArray:
    """Power across a direction; shape (bins,)."""
    across = _turned(direction)
    return np.asarray(np.einsum("i,ijf,j->f", across, power, across))


def _largest(power: FloatArray) -> FloatArray:
    """Power in the direction in which it is largest, in each bin; shape (bins,)."""
    return np.asarray(np.linalg.eigvalsh(np.moveaxis(power, 2, 0))[:, 1])


def _power(filled: FloatArray) -> FloatArray:
    """Real part of the cross spectra of x and y, summed over markers; shape (2, 2, bins)."""
    spectra = np.fft.rfft(filled * np.hanning(filled.shape[1])[None, :, None], axis=1)
    return np.asarray(np.real(np.einsum("ifm,jfm->ijf", spectra, np.conj(spectra))))


def _lines(power: FloatArray) -> FloatArray:
    """Mask of the bins that belong to lines of this power.

    Judged by the spectrum of the velocity, in which drift and jumps are flat.
    """
    bins = np.arange(power.size)
    velocity = power * np.sin(0.5 * np.pi * bins / bins[-1]) ** 2
    level = median_filter(velocity, min(TUNING.neighbours, velocity.size // 2), mode="reflect")
    return np.asarray(velocity > TUNING.line * np.maximum(level, 1e-300))

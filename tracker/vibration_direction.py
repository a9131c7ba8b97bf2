"""Direction of the vibration of tracked markers, whatever else they do."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from tracker.arrays import FloatArray

# A line of the spectrum exceeds the median over this number of bins by this factor; a bin of noise by up to about ten.
_NEIGHBOURS, _LINE = 101, 30.0
_LEAST_FRAMES = 64


def vibration_direction(centred: FloatArray) -> FloatArray:
    """Unit vector, shape (2,), of the largest power in the lines of the spectrum; its larger component is positive.

    Drift and jumps of markers, which have no lines, may exceed the vibration and lie across it: a patch slides along an
    edge. Without any line, the direction is that of the largest variance.

    Parameters
    ----------
    centred : array, shape (2, n, m)
        x and y of m markers in n frames about their means; NaN where unknown.
    """
    known = np.isfinite(centred).all(axis=0)
    if not known.any():
        return np.array([1.0, 0.0])
    filled = np.where(known, centred, 0.0)
    moment = np.einsum("inm,jnm->ij", filled, filled)
    if centred.shape[1] >= _LEAST_FRAMES:
        power = _power(filled)
        lines = _lines(power)
        if np.any(lines):
            moment = np.sum(power[:, :, lines], axis=2)
    vector = np.linalg.eigh(moment)[1][:, 1]
    return np.asarray(vector if vector[np.argmax(np.abs(vector))] > 0 else -vector)


def _power(filled: FloatArray) -> FloatArray:
    """Real part of the cross spectra of x and y, summed over markers; shape (2, 2, bins)."""
    spectra = np.fft.rfft(filled * np.hanning(filled.shape[1])[None, :, None], axis=1)
    return np.asarray(np.real(np.einsum("ifm,jfm->ijf", spectra, np.conj(spectra))))


def _lines(power: FloatArray) -> FloatArray:
    """Mask of the bins that belong to lines.

    Judged by the spectrum of the velocity, in which drift and jumps are flat.
    """
    bins = np.arange(power.shape[2])
    velocity = np.linalg.eigvalsh(np.moveaxis(power, 2, 0))[:, 1] * np.sin(0.5 * np.pi * bins / bins[-1]) ** 2
    level = median_filter(velocity, min(_NEIGHBOURS, velocity.size // 2), mode="reflect")
    return np.asarray(velocity > _LINE * np.maximum(level, 1e-300))

"""Many channels reduced to a few components, in which the modes are fitted at the cost of a few channels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammainc, gammaincinv

from modal_id.data.prepare import Prepared, Projection
from modal_id.data.samples import FitData, limited, reject_outliers
from modal_id.sentences import Note
from tracker import MAD_TO_SD, FloatArray

# Fewer channels are fitted directly.
MOST_DIRECT = 16


@dataclass(frozen=True)
class Tuning:
    """Many channels projected on few components."""

    #: [bins] number of spectral bins in a band
    #: convention: In its band a mode stands out that is below the noise of the whole spectrum.
    band_bins: int = 16
    #: [1] value of the Tracy-Widom law of order 1 above which a component is signal
    #: statistics: Noise exceeds it with 1e-4, by simulation 2 to 4 with 1e-2 to 1e-3.
    tracy_widom: float = 5.0
    #: [1] largest number of components
    most_components: int = 40
    #: [1] largest number of passes with all directions
    most_passes: int = 12
    #: [sd] largest change of a value filled in at the end of the passes
    settled: float = 0.1
    #: [sd] deviation from the mean of its neighbours above which a sample does not shape the first basis
    spike_sd: float = 8.0
    #: [1] channels to a component below which nothing is projected
    #: physics: The components are hardly less than the channels.
    channels_each: int = 3
    #: [1] noise over a channel's motion below which it is that of rounding
    least_noise: float = 1e-6
    #: [1] measured noise over the stated sd below which it is not that of positions
    #: measurement: Filmed forks in predictive codecs have 0.01 to 0.4, others 0.4 to 1.2.
    least_of_stated: float = 0.5
    #: [1] information on a component at an instant over that of all channels below which it is unseen
    #: physics: Above rounding.
    least_seen: float = 1e-9


TUNING = Tuning()

# Largest number of directions in the first passes: what interpolation does at outliers and missing samples is weaker
# than the motion, and the passes replace it.
_FIRST_PASSES = (2, 4, 8)


def project(prepared: Prepared, components: int | None) -> Prepared:
    """Reduce many channels to components; the channels themselves if they are few, or their motions too many.

    Parameters
    ----------
    prepared : Prepared
    components : int or None
        Their number; None chooses it from the noise, 0 keeps the channels.

    Returns
    -------
    Prepared
        With the components as its data and a `projection`, or unchanged.

    Notes
    -----
    The channels, divided by their noise, are projected on an orthonormal basis V of their motion. White noise remains
    white: its covariance is ``V^T V = I``; where the noise of neighbouring channels is correlated, the components are
    rotated and scaled until theirs is not. At an instant at which channels are missing or noisier than usual (weights
    W), the component values are the weighted least-squares solution, with the covariance ``(V^T W V)^-1``.

    V holds the directions of the singular vectors, of any band of the spectrum, whose singular values exceed the
    largest of white noise (Johnstone, On the distribution of the largest eigenvalue in principal components analysis,
    2001, doi:10.1214/aos/1009210544), with the level of the noise from the band's median singular value. What lies
    outside of V is noise: the poles lose no information with it. Samples further than 5 sd from the basis are outliers
    of their channel.
    """
    data = prepared.data
    k = data.values.shape[1]
    if components == 0 or k <= (MOST_DIRECT if components is None else components):
        return prepared
    weights, least_sd = data.weights, TUNING.least_of_stated * np.nan_to_num(prepared.stated_sd)
    centred = _centred(data, weights)
    basis, filled = np.zeros((k, 0)), _interpolated(data.time_s, centred, weights)
    most = components or min(TUNING.most_components, k // TUNING.channels_each)
    for limit in (*_FIRST_PASSES, *(most,) * TUNING.most_passes):
        # what is filled in has no noise
        sd = np.maximum(_noise_sd(filled) / np.sqrt(np.mean(weights > 0.0, axis=0)), least_sd)
        basis = _basis(filled / sd, min(limit, most), always=components is not None)
        if basis.shape[1] == 0:
            return prepared
        values, _ = _seen(centred / sd, weights, basis)
        # The mean of a channel is over the samples that it has, and these are others in each channel.
        motion = (values @ basis.T) * sd
        centred = _centred(data, weights, motion)
        residual = (centred - motion) / sd
        weights = reject_outliers(data, data.weights, residual).weights
        # Large samples beside motion that is not in the basis yet are not rejected, but could enter it on their own.
        before, filled = filled, motion + np.where(weights > 0.0, sd * limited(data.weights, residual), 0.0)
        if limit == most and float(np.max(np.abs(filled - before) / sd)) < TUNING.settled:
            break
    if components is None and most == basis.shape[1] < TUNING.most_components:
        return prepared
    cleaned = FitData(data.time_s, data.values, weights)
    return _reduced(prepared, cleaned, centred / sd, basis, sd, least_sd)


def _reduced(
    prepared: Prepared,
    cleaned: FitData,
    whitened: FloatArray,
    basis: FloatArray,
    sd: FloatArray,
    least_sd: FloatArray,
) -> Prepared:
    """Components with uncorrelated noise, in order of their signal, each as large as the motion of a channel."""
    values, covariance = _seen(whitened, cleaned.weights, basis)
    turn = _uncorrelated(values, (basis.T * (least_sd / sd) ** 2) @ basis)
    to_channels = sd[:, None] * (basis @ np.linalg.inv(turn).T)
    scale = np.max(np.abs(to_channels), axis=0)
    turn, to_channels = turn * scale, to_channels / scale
    # Relative to the best rows: an instant at which every channel is seen has weight 1.
    complete = np.sum(turn**2, axis=0)
    variance = np.einsum("qa,nqp,pa->na", turn, covariance, turn)
    weights = complete / variance
    weights[np.all(cleaned.weights == 0.0, axis=1)] = 0.0
    components = FitData(cleaned.time_s, np.where(weights > 0.0, values @ turn, 0.0), weights, scale**2)
    projection = Projection(cleaned, to_channels, (basis @ turn).T / sd)
    count, k = basis.shape[1], sd.size
    rejected = int(np.count_nonzero((prepared.data.weights > 0.0) & (cleaned.weights == 0.0)))
    note = (Note.COMPONENTS if count > 1 else Note.ONE_COMPONENT)(count=count, channels=k, rejected=rejected)
    return replace(prepared, data=components, notes=(*prepared.notes, note), projection=projection)


def _centred(data: FitData, weights: FloatArray, motion: FloatArray | float = 0.0) -> FloatArray:
    """Values less their weighted mean difference from the motion in each channel; 0 where missing."""
    total = np.maximum(np.sum(weights, axis=0), 1e-300)
    mean = np.sum(weights * (data.values - motion), axis=0) / total
    return np.asarray(np.where(data.weights > 0.0, data.values - mean, 0.0))


def _interpolated(time_s: FloatArray, values: FloatArray, weights: FloatArray) -> FloatArray:
    """Values with missing ones and single spikes interpolated in time, only to find a first basis."""
    filled = values.copy()
    for channel in range(values.shape[1]):
        used = np.flatnonzero(weights[:, channel] > 0.0)
        own = values[used, channel]
        bend = np.abs(own[1:-1] - 0.5 * (own[:-2] + own[2:]))
        around = np.pad(bend, 1)
        spike = (bend > TUNING.spike_sd * MAD_TO_SD * np.median(bend)) & (
            bend >= np.maximum(around[:-2], around[2:])
        )
        kept = np.ones(used.size, dtype=bool)
        kept[1:-1] = ~spike
        if used.size < time_s.size or not np.all(kept):
            good = used[kept]
            other = np.setdiff1d(np.arange(time_s.size), good)
            filled[other, channel] = np.interp(time_s[other], time_s[good], values[good, channel])
    return filled


def _noise_sd(values: FloatArray) -> FloatArray:
    """Standard deviation of each channel's noise: that of white noise with the median power of the spectrum.

    The lines of the motion fill few bins, as long as a window keeps the beginning of a decay out of the others.
    """
    window = np.hanning(values.shape[0])
    power = np.abs(np.fft.rfft(window[:, None] * values, axis=0)[1:]) ** 2
    variance = np.median(power, axis=0) / (np.log(2.0) * np.sum(window**2))
    return np.asarray(
        np.sqrt(np.maximum(variance, TUNING.least_noise**2 * np.mean(values**2, axis=0) + 1e-300))
    )


def _basis(whitened: FloatArray, most: int, *, always: bool) -> FloatArray:
    """Orthonormal basis, shape (k, r), of the motion that some band of the spectrum shows, strongest first.

    One direction at a time, that of all bands with motion together, is taken off all of them. It has at most `most`
    directions, and exactly as many with `always`.
    """
    # without the last bin of an even number of samples, which is real: its noise has twice the power
    inner = slice(1, (whitened.shape[0] + 1) // 2)
    spectrum = np.fft.rfft(whitened, axis=0)[inner] * np.sqrt(2.0 / whitened.shape[0])
    step = TUNING.band_bins // 2
    bands = [
        np.concatenate([band.real, band.imag])
        for band in (
            spectrum[i : i + TUNING.band_bins] for i in range(0, max(1, spectrum.shape[0] - step), step)
        )
    ]
    found: list[FloatArray] = []
    while bands and len(found) < most:
        shown = [_motion(band, len(found), always=always) for band in bands]
        bands = [band for band, motion in zip(bands, shown, strict=True) if motion.size]
        if not bands:
            break
        direction = _main_direction(np.concatenate(shown))
        found.append(direction)
        bands = [band - np.outer(band @ direction, direction) for band in bands]
    return np.stack(found, axis=1) if found else np.zeros((whitened.shape[1], 0))


def _main_direction(motion: FloatArray) -> FloatArray:
    """First right singular vector, of the smaller Gram matrix."""
    if motion.shape[0] >= motion.shape[1]:
        return np.asarray(np.linalg.eigh(motion.T @ motion)[1][:, -1])
    direction = motion.T @ np.linalg.eigh(motion @ motion.T)[1][:, -1]
    return np.asarray(direction / np.linalg.norm(direction))


def _motion(band: FloatArray, removed: int, *, always: bool) -> FloatArray:
    """Singular vectors of a band that exceed noise, times their singular values; at least the first with `always`.

    `removed` directions have been taken off the channels.
    """
    # of the smaller Gram matrix: its squares are exact enough to compare with noise
    small = band if band.shape[0] <= band.shape[1] else band.T
    square, vectors = np.linalg.eigh(small @ small.T)
    shape = (band.shape[0], band.shape[1] - removed)
    size = np.sqrt(np.maximum(square, 0.0))
    kept = size > _largest_of_noise(shape, size[-min(shape) :])
    kept[-1] |= always
    if small is band:
        return np.asarray(vectors[:, kept].T @ band)
    return np.asarray(size[kept, None] * vectors[:, kept].T)


def _largest_of_noise(shape: tuple[int, int], size: FloatArray) -> float:
    """Singular value that white noise with the median of `size` exceeds with a probability of about 1e-4."""
    small, large = np.sqrt(min(shape)), np.sqrt(max(shape))
    edge = (small + large) ** 2
    spread = (small + large) * (1.0 / small + 1.0 / large) ** (1.0 / 3.0)
    variance = float(np.median(size)) ** 2 / _median_of_noise(small, large)
    return float(np.sqrt(variance * (edge + TUNING.tracy_widom * spread)))


def _median_of_noise(small: float, large: float) -> float:
    """Median eigenvalue of the Marchenko-Pastur law for a matrix of independent standard normal entries."""
    low, high = (large - small) ** 2, (large + small) ** 2
    # in an angle, in which the density has no root at its ends
    angle = np.linspace(0.0, np.pi, 401)
    value = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)
    mass = np.cumsum(np.sin(angle) ** 2 / np.maximum(value, 1e-12 * high))
    return float(np.interp(0.5 * mass[-1], mass, value))


def _seen(whitened: FloatArray, weights: FloatArray, basis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Component values, shape (n, r), and their covariances for unit noise, (n, r, r)."""
    n, r = whitened.shape[0], basis.shape[1]
    values = whitened @ basis
    covariance = np.broadcast_to(np.eye(r), (n, r, r)).copy()
    for rows in np.array_split(np.flatnonzero(np.any(weights != 1.0, axis=1)), max(1, n // 256)):
        own = weights[rows]
        information = (basis[None] * own[:, :, None]).transpose(0, 2, 1) @ basis
        covariance[rows] = np.linalg.inv(information + TUNING.least_seen * np.eye(r))
        values[rows] = np.einsum("nqp,np->nq", covariance[rows], (own * whitened[rows]) @ basis)
    return values, covariance


def _uncorrelated(values: FloatArray, least: FloatArray) -> FloatArray:
    """Matrix T, (r, r), for which the components ``values @ T`` have uncorrelated unit noise, largest motion first.

    The noise is estimated from the quieter half of the bins of the spectrum. In no direction it is below that of the
    covariance `least`, (r, r).
    """
    window = np.hanning(values.shape[0])
    spectrum = np.fft.rfft(window[:, None] * values, axis=0)[1:] / np.sqrt(0.5 * np.sum(window**2))
    power = np.sum(np.abs(spectrum) ** 2, axis=1)
    quiet = spectrum[power <= np.median(power)]
    r = values.shape[1]
    # of white noise, the sum over the components of a bin is chi-square with 2 r degrees of freedom
    share = 2.0 * gammainc(r + 1.0, gammaincinv(r, 0.5))
    noise = np.real(quiet.conj().T @ quiet) / (2.0 * share * quiet.shape[0])
    lacks, directions = np.linalg.eigh(least - noise)
    noise += (directions * np.maximum(lacks, 0.0)) @ directions.T
    size, vectors = np.linalg.eigh(noise)
    whiten = vectors / np.sqrt(np.maximum(size, 1e-12 * size[-1]))
    _, _, turn = np.linalg.svd(values @ whiten, full_matrices=False)
    return np.asarray(whiten @ turn.T)

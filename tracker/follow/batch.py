"""All markers of a frame in one compiled call each: register, judge, take over."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.follow.predict import LONGEST_EXTRAPOLATION, MEMORY, WEIGHTS, Memory, predict_all, update_all
from tracker.register import kernel

# Columns of the limits that `all_believed` and `take_over` need of each marker.
USUAL_CHI2, SIZE_PX, IS_ARUCO, LIMITS = 0, 1, 2, 3
# How far `follow_plain` came.
UNTOUCHED, REGISTERED, FOLLOWED = 0, 1, 2


@njit(cache=True, nogil=True, error_model="numpy")
def register_all(
    image: GrayImage,
    aims: FloatArray,
    states: FloatArray,
    warps: FloatArray,
    coefs: NDArray[np.float32],
    support: NDArray[np.uint8],
    places: NDArray[np.int64],
    shapes: FloatArray,
    noise: FloatArray,
    saturation: float,
    results: FloatArray,
) -> None:
    """Register m markers, each with its template at rest; see `tracker.register.kernel.register`.

    Parameters
    ----------
    aims : array, shape (m, 2)
    states : array, shape (m, 5)
    warps : array, shape (m, 2, 2)
    coefs : float32 array, shape (n,)
    support : uint8 array, shape (n,)
        Grid points of all templates one after the other.
    places : int array, shape (m, 5)
        First grid point of each marker's template, its rows and columns, the stride, and whether the angle is free.
    shapes : array, shape (m, 3)
        Oversampling, reach and largest shift.
    results : array, shape (m, 14)
        Filled.
    """
    start = np.empty(kernel.STATE)
    space = kernel.make_space()
    for k in range(aims.shape[0]):
        first, rows, cols = places[k, 0], places[k, 1], places[k, 2]
        size = rows * cols
        # Entry by entry: numba compiles for two seconds at the error text of an array's assignment.
        for i in range(2, kernel.STATE):
            start[i] = states[k, i]
        start[0] = aims[k, 0]
        start[1] = aims[k, 1]
        kernel.register(
            image,
            start,
            warps[k],
            coefs[first : first + size].reshape((rows, cols)),
            support[first : first + size].reshape((rows, cols)),
            shapes[k, 0],
            shapes[k, 1],
            places[k, 3],
            noise,
            saturation,
            space,
            places[k, 4] != 0,
            shapes[k, 2],
            results[k],
        )


@njit(cache=True, nogil=True, error_model="numpy")
def correlation(result: FloatArray) -> float:
    """Correlation of pixels and template that a fit reached, 0 where it failed."""
    if result[kernel.CONVERGED] == 0.0:
        return 0.0
    signal, rest = result[kernel.SIGNAL], result[kernel.CHI2]
    return float(np.sqrt(signal / (signal + rest))) if signal + rest > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def believed(result: FloatArray, gain: float, usual_chi2: float, rules: FloatArray, least: float) -> bool:
    """Whether a fit is a marker: see the names of the rules in `tracker.follow.fits`.

    Parameters
    ----------
    gain : float
        Gain of the last good fit, NaN where there is none.
    rules : array, shape (5,)
        Least share seen, least signal, least correlation, limit of a good chi-square, and the correlation below
        which a marker's shape is looked at anew.
    least : float
        Correlation that is asked for.
    """
    if result[kernel.CONVERGED] == 0.0 or result[kernel.SEEN] < rules[0]:
        return False
    # An even surface is explained perfectly by a template without contrast: that is no marker.
    if result[kernel.SIGNAL] * result[kernel.PIXELS] < rules[1]:
        return False
    if np.isfinite(gain) and not 0.3 < result[kernel.GAIN] / gain < 3.0:
        return False
    # With little contrast the correlation is low however good the fit is: then the noise decides.
    return correlation(result) >= least or (result[kernel.CHI2] < rules[3] * usual_chi2 and least <= rules[2])


@njit(cache=True, nogil=True, error_model="numpy")
def all_plain(results: FloatArray, states: FloatArray, limits: FloatArray, rules: FloatArray) -> bool:
    """Whether every fit is believed, no marker lies on another and none fits so badly that its shape is in doubt."""
    for k in range(results.shape[0]):
        usual = limits[k, USUAL_CHI2]
        if not believed(results[k], states[k, 3], usual, rules, rules[2]):
            return False
        if (
            limits[k, IS_ARUCO] != 0.0
            and results[k, kernel.CHI2] > rules[3] * usual
            and correlation(results[k]) < rules[4]
        ):
            return False
        near = 0.4 * limits[k, SIZE_PX]
        for other in range(k):
            dx, dy = results[k, 0] - results[other, 0], results[k, 1] - results[other, 1]
            if dx * dx + dy * dy < near * near:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def take_over(
    results: FloatArray,
    marks: NDArray[np.uint32],
    motion: FloatArray,
    warps: FloatArray,
    centres_uv: FloatArray,
    limits: FloatArray,
    seen_share: float,
    bits: NDArray[np.uint32],
    states: FloatArray,
    lost: NDArray[np.int64],
    places: FloatArray,
    out: FloatArray,
) -> None:
    """Results to positions, sd and flags, and to the states from which the next frame starts.

    Parameters
    ----------
    marks : uint32 array, shape (m,)
        Flags so far; completed.
    bits : uint32 array, shape (5,)
        Values of NOT_FOUND, EDGE, SATURATED, BLURRED and POOR_FIT.
    places : array, shape (m, 2)
        Filled with the positions for the prediction, NaN where missing.
    out : array, shape (4, m)
        Filled with x, y and their sd.
    """
    for k in range(results.shape[0]):
        result = results[k]
        if result[kernel.CONVERGED] == 0.0:
            lost[k] += 1
            marks[k] = bits[0]
            places[k, 0] = places[k, 1] = np.nan
            for i in range(4):
                out[i, k] = np.nan
            continue
        lost[k] = 0
        places[k, 0], places[k, 1] = result[0], result[1]
        chi2, pixels = result[kernel.CHI2], max(result[kernel.PIXELS], 1.0)
        enlarged = np.sqrt(max(1.0, chi2))
        cosine, sine = np.cos(result[kernel.ANGLE]), np.sin(result[kernel.ANGLE])
        u = cosine * centres_uv[k, 0] - sine * centres_uv[k, 1]
        v = sine * centres_uv[k, 0] + cosine * centres_uv[k, 1]
        if not np.isfinite(u):
            u, v = 0.0, 0.0
        w = warps[k]
        det = w[0, 0] * w[1, 1] - w[0, 1] * w[1, 0]
        out[0, k] = result[0] + (w[1, 1] * u - w[0, 1] * v) / det
        out[1, k] = result[1] + (w[0, 0] * v - w[1, 0] * u) / det
        out[2, k] = result[kernel.SD_X] * enlarged
        out[3, k] = result[kernel.SD_Y] * enlarged
        if result[kernel.SEEN] < seen_share:
            marks[k] |= bits[1]
        if result[kernel.SATURATED] > 0.01 * pixels:
            marks[k] |= bits[2]
        if np.hypot(motion[k, 0], motion[k, 1]) > 1.0:
            marks[k] |= bits[3]
        # Six standard deviations of a chi-square per degree of freedom, and half as much again as is usual.
        if chi2 > max(1.0 + 6.0 * np.sqrt(2.0 / pixels), 1.5 * limits[k, USUAL_CHI2], 1.5):
            marks[k] |= bits[4]
        if np.isfinite(result[kernel.GAIN]):
            for i in range(kernel.STATE):
                states[k, i] = result[i]


@njit(cache=True, nogil=True, error_model="numpy")
def follow_plain(
    image: GrayImage,
    memory: Memory,
    states: FloatArray,
    gains: FloatArray,
    lost: NDArray[np.int64],
    warps: FloatArray,
    coefs: NDArray[np.float32],
    support: NDArray[np.uint8],
    places: NDArray[np.int64],
    shapes: FloatArray,
    centres_uv: FloatArray,
    limits: FloatArray,
    noise: FloatArray,
    saturation: float,
    exposure_share: float,
    most_blur: float,
    rules: FloatArray,
    seen_share: float,
    bits: NDArray[np.uint32],
    aims: FloatArray,
    motion: FloatArray,
    results: FloatArray,
    marks: NDArray[np.uint32],
    out: FloatArray,
) -> int:
    """Follow all markers through a frame in which nothing is out of the ordinary, in one call.

    It leaves the interpreter to the thread that decodes for as long as the frame takes.

    Parameters
    ----------
    memory : tuple of arrays
        Of `tracker.follow.predict.Predictor`.
    states, gains, lost : arrays of m rows
        Renewed.
    most_blur : float
        Motion during the exposure, in px, from which templates at rest do not do.
    rules, seen_share, bits :
        Of `all_plain` and `take_over`.
    aims, motion, results, marks, out : arrays
        Filled.

    Returns
    -------
    int
        `FOLLOWED` when all is done; `REGISTERED` when `aims`, `motion` and `results` are filled, but not all is
        plain; `UNTOUCHED` when markers are blurred or without a state. But for `FOLLOWED` nothing is renewed.
    """
    past, error, known, gone, trusted = memory
    predict_all(past, error, known, WEIGHTS, aims, motion)
    for k in range(aims.shape[0]):
        for c in range(2):
            motion[k, c] *= exposure_share
        if not (np.isfinite(states[k, kernel.GAIN]) and np.hypot(motion[k, 0], motion[k, 1]) < most_blur):
            return UNTOUCHED
    register_all(image, aims, states, warps, coefs, support, places, shapes, noise, saturation, results)
    if not all_plain(results, states, limits, rules):
        return REGISTERED
    where = np.empty((aims.shape[0], 2))
    take_over(results, marks, motion, warps, centres_uv, limits, seen_share, bits, states, lost, where, out)
    for k in range(aims.shape[0]):
        if np.isfinite(states[k, kernel.GAIN]):
            gains[k] = states[k, kernel.GAIN]
    update_all(past, error, known, gone, trusted, WEIGHTS, MEMORY, LONGEST_EXTRAPOLATION, where)
    return FOLLOWED

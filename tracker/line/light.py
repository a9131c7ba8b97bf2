"""Light along a line: gain and offset of a station from those of its neighbours, where these tell them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable

from tracker.arrays import BoolArray, FloatArray
from tracker.line import kernel
from tracker.line.kernel import solve_in_place


@dataclass(frozen=True)
class Tuning:
    """Light along an edge."""

    #: [1] of the polynomial along the line that describes a change of light
    #: convention: light changes smoothly: a parabola
    terms: int = 3
    #: [stations] on either side whose scatter about it decides how far to trust it
    neighbours: int = 5


TUNING = Tuning()
# Frozen into compiled code.
NEIGHBOURS = TUNING.neighbours
FEW_STATIONS = (
    f"light along a line: expected at least {TUNING.terms} stations with a fit; leave out the frame"
)


class Light(NamedTuple):
    """What the first frames tell of gain and offset.

    `typical` (m, 2) are those of each station; `basis` (m, terms) are the polynomials of their changes along the line;
    `share` is the part of the effect of their scatter on the displacement that is error, 0 to 1; `scatter` is the
    variance of that effect relative to the one stated.
    """

    typical: FloatArray
    basis: FloatArray
    share: float
    scatter: float


UNKNOWN_LIGHT = Light(np.zeros((0, 2)), np.zeros((0, TUNING.terms)), 0.0, 1.0)


def light_basis(stations: int) -> FloatArray:
    """Legendre polynomials over the stations, shape (stations, `TUNING.terms`)."""
    return np.ascontiguousarray(
        np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, stations), TUNING.terms - 1)
    )


def learned_light(
    fits: FloatArray, used: BoolArray, off_smooth: Callable[[FloatArray, BoolArray], FloatArray]
) -> Light:
    """Light of an edge from the results of its stations in the first frames.

    Parameters
    ----------
    fits : array, shape (n, m, 14)
        Results of `tracker.line.kernel.register_line`, and which of them are `used` (n, m).
    off_smooth : callable
        From values at the stations (m,) and which of them are used, the difference from a smooth line through these.

    Notes
    -----
    The share is that of a regression: displacements off the smooth line on what the scatter of the light would change
    them by. It is 1 for white noise; less where the light itself scatters, as before a background with texture.
    """
    known = np.where(used[:, :, None], fits, np.nan)
    seen = np.count_nonzero(used, axis=0) > 0
    typical = np.tile([1.0, 0.0], (used.shape[1], 1))
    typical[seen] = np.nanmean(known[:, seen, kernel.GAIN : kernel.OFFSET + 1], axis=0)
    light = Light(typical, light_basis(used.shape[1]), 1.0, 1.0)
    change, off_line, off_light = (np.full(used.shape, np.nan) for _ in range(3))
    for k, (results, good) in enumerate(zip(fits, used, strict=True)):
        known_light_shift(light, results, good, change[k])
        off_line[k, good] = off_smooth(results[:, kernel.SHIFT], good)[good]
        off_light[k, good] = off_smooth(change[k], good)[good]
    off_line[:, seen] -= np.nanmean(off_line[:, seen], axis=0)
    share = -np.nansum(off_line * off_light) / max(float(np.nansum(off_light**2)), 1e-12)
    stated = np.nanmean(known[:, :, kernel.SD] ** 2 - known[:, :, kernel.SD_KNOWN] ** 2)
    scatter = np.mean(change[used] ** 2) / max(float(stated), 1e-12)
    return light._replace(share=float(np.clip(share, 0.0, 1.0)), scatter=float(max(scatter, 1e-12)))


@njit(cache=True, nogil=True, error_model="numpy")
def known_light_shift(light: Light, results: FloatArray, used: BoolArray, out: FloatArray) -> None:
    """Change of each displacement, (m,), if gain and offset were as smooth along the line as light is.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where fewer than `TUNING.terms` stations are used; a follower uses none with so few.
    """
    m, terms = light.basis.shape
    normal, rhs, smooth = np.zeros((terms, terms)), np.zeros((2, terms)), np.zeros((2, terms))
    for k in range(m):
        if not used[k]:
            continue
        for i in range(terms):
            for c in range(2):
                rhs[c, i] += light.basis[k, i] * (results[k, kernel.GAIN + c] - light.typical[k, c])
            for j in range(terms):
                normal[i, j] += light.basis[k, i] * light.basis[k, j]
    for c in range(2):
        if not solve_in_place(normal.copy(), rhs[c], smooth[c]):
            raise np.linalg.LinAlgError(FEW_STATIONS)
    for k in range(m):
        out[k] = 0.0
        if not used[k]:
            continue
        for c in range(2):
            off = results[k, kernel.GAIN + c] - light.typical[k, c]
            for i in range(terms):
                off -= light.basis[k, i] * smooth[c, i]
            out[k] += off * results[k, kernel.BY_GAIN + c]


@register_jitable(error_model="numpy")
def hold_light(light: Light, results: FloatArray, used: BoolArray) -> None:
    """Change displacement and sd of the stations used to those for the light of their neighbours.

    Notes
    -----
    Gain and offset of a station have as prior the smooth light, with the variance by which its neighbours scatter about
    it beyond their errors. Light that changes from station to station so loses its weight where it does.
    """
    m = used.size
    change, squares = np.empty(m), np.zeros(m)
    known_light_shift(light, results, used, change)
    for k in range(m):
        if used[k]:
            variance = results[k, kernel.SD] ** 2 - results[k, kernel.SD_KNOWN] ** 2
            squares[k] = change[k] ** 2 / max(light.scatter * variance, 1e-12)
    for k in range(m):
        if not used[k]:
            continue
        total = count = 0.0
        for i in range(max(k - NEIGHBOURS, 0), min(k + NEIGHBOURS + 1, m)):
            if used[i]:
                total += squares[i]
                count += 1.0
        trust = light.share / max(total / count, 1.0)
        variance, known = results[k, kernel.SD] ** 2, results[k, kernel.SD_KNOWN] ** 2
        results[k, kernel.SHIFT] += trust * change[k]
        results[k, kernel.SD] = np.sqrt(known + (1.0 - trust) * (variance - known))

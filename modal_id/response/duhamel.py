"""Response of a complex first-order system to a sampled input: two linear columns of a mode that an input drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline

from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Integration of one time step."""

    #: [1] largest |lambda| h at which the integrals of a step are summed as a series
    #: physics: The recursion that is used above it loses three digits here, and more below.
    series: float = 0.3
    #: [1] relative change of the time step above which its integrals are computed again
    #: physics: Time stamps are rounded to about nine digits.
    same_step: float = 1e-9
    #: [1] step of the derivative with respect to lambda, over |Re lambda| + 1 / span
    #: physics: Error of the central difference 1e-10, of rounding 1e-11.
    difference: float = 1e-5


TUNING = Tuning()
_SERIES, _SAME_STEP = TUNING.series, TUNING.same_step


@dataclass(frozen=True)
class Drive:
    """An input between its samples: a cubic spline, of which the response is integrated exactly.

    Attributes
    ----------
    steps_s : array, shape (n - 1,)
        From each sample to the next; may differ.
    coefficients : array, shape (4, n - 1)
        Of the polynomial in the time from the sample before, highest power first.
    """

    steps_s: FloatArray
    coefficients: FloatArray

    def response(self, pole: complex) -> ComplexArray:
        """Solution z of ``z' = lambda z + u``, ``z = 0`` at the first sample, at the samples; shape (n,).

        Exact for the spline whatever the time step. The error is that of the spline: for an input at frequency f
        sampled at rate r about ``(2 pi f / r)^4 / 720``.
        """
        return _response(complex(pole), self.steps_s, self.coefficients)

    def at_samples(self) -> FloatArray:
        """The input at the samples, gaps filled; shape (n,)."""
        end = np.polyval(self.coefficients[:, -1], self.steps_s[-1])
        return np.append(self.coefficients[3], end)

    def curvature(self) -> FloatArray:
        """Second derivative of the input at the samples; shape (n,)."""
        end = 2.0 * self.coefficients[1, -1] + 6.0 * self.coefficients[0, -1] * self.steps_s[-1]
        return np.append(2.0 * self.coefficients[1], end)

    def derivative(self) -> Drive:
        """The first derivative of the input, itself an input."""
        a, b, c, _ = self.coefficients
        return Drive(self.steps_s, np.stack([np.zeros(a.size), 3.0 * a, 2.0 * b, c]))

    def slope(self, pole: complex) -> ComplexArray:
        """Derivative of the response with respect to lambda, of which it is an analytic function; shape (n,)."""
        step = TUNING.difference * (abs(pole.real) + 1.0 / float(np.sum(self.steps_s)))
        return (self.response(pole + step) - self.response(pole - step)) / (2.0 * step)


def drive(time_s: FloatArray, values: FloatArray) -> Drive:
    """The input between samples; `values`, shape (n,), are taken through a gap (NaN) by the spline of the others."""
    seen = np.isfinite(values)
    spline = CubicSpline(time_s[seen], values[seen])
    if not seen.all():
        spline = CubicSpline(time_s, spline(time_s))
    return Drive(np.diff(time_s), np.ascontiguousarray(spline.c))


@njit(cache=True, nogil=True, error_model="numpy")
def _response(pole: complex, steps_s: FloatArray, coefficients: FloatArray) -> ComplexArray:
    found = np.zeros(steps_s.size + 1, np.complex128)
    integrals = np.zeros(4, np.complex128)
    growth, step = 1.0 + 0.0j, -1.0
    for at in range(steps_s.size):
        if abs(steps_s[at] - step) > _SAME_STEP * step or step < 0.0:
            step = steps_s[at]
            growth = np.exp(pole * step)
            _integrals(pole, step, growth, integrals)
        total = growth * found[at]
        for power in range(4):
            total += coefficients[3 - power, at] * integrals[power]
        found[at + 1] = total
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _integrals(pole: complex, step: float, growth: complex, into: ComplexArray) -> None:
    """Integrals of ``exp(lambda (h - s)) s^p`` over s from 0 to h, p = 0..3."""
    if abs(pole * step) > _SERIES:
        into[0] = (growth - 1.0) / pole
        for power in range(1, 4):
            into[power] = (power * into[power - 1] - step**power) / pole
        return
    for power in range(4):
        term = step ** (power + 1) / (power + 1) + 0.0j
        into[power] = term
        for k in range(1, 16):
            term *= pole * step / (k + power + 1)
            into[power] += term

"""The recorded input at any lag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from modal_id.response.duhamel import drive
from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Interpolation of the input."""

    #: [1] degree of the spline between the samples
    #: physics: At 0.6 of the Nyquist frequency, the highest of the fit, it changes a sinusoid by 0.5 % at most.
    degree: int = 7


TUNING = Tuning()


@dataclass(frozen=True)
class Channel:
    """The input as a function of time, and which outputs are given where it is known.

    Attributes
    ----------
    spline : BSpline
        Through the samples, gaps filled.
    start_s, end_s : float
        First and last sample.
    given : bool array, shape (n, k)
        Outputs that are not missing.
    """

    spline: BSpline
    start_s: float
    end_s: float
    given: BoolArray

    @classmethod
    def through(cls, time_s: FloatArray, values: FloatArray, given: BoolArray) -> Channel:
        """Of samples, shape (n,), NaN where missing."""
        spline = make_interp_spline(time_s, drive(time_s, values).at_samples(), TUNING.degree)
        return cls(spline, float(time_s[0]), float(time_s[-1]), given)

    def at(self, time_s: FloatArray, lag_s: float) -> tuple[FloatArray, BoolArray]:
        """The input of which the record at `time_s` is `lag_s` late, and whether it was recorded; shapes (n,).

        Before the first and after the last sample it is that sample.
        """
        late = time_s + lag_s
        inside = (late >= self.start_s) & (late <= self.end_s)
        values = self.spline(np.clip(late, self.start_s, self.end_s))
        return np.asarray(values, dtype=np.float64), np.asarray(inside)

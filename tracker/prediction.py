"""Prediction from frame to frame by polynomials: the same for a marker and for a line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Tuning:
    """Choice of the degree of the polynomial, and how long it is continued."""

    #: [1] share of the newest error in the running mean that selects the degree
    newest_share: float = 0.2
    #: [px] error that counts at most
    #: convention: about a marker's distance: else one jump would dominate for long
    largest_error_px: float = 10.0
    #: [frames] for which what was lost is extrapolated; then it is expected where it was last
    #: convention: errors of a cubic grow with the third power of the frames
    longest_extrapolation: int = 4


TUNING = Tuning()
# Polynomials of degree 0 to 3 through the last positions, the latest first: weights for the next one.
AHEAD = np.array([[1.0, 0.0, 0.0, 0.0], [2.0, -1.0, 0.0, 0.0], [3.0, -3.0, 1.0, 0.0], [4.0, -6.0, 4.0, -1.0]])

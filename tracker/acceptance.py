"""What following a marker and a station of a line share: when a fit is accepted, its flags, prediction of the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Tuning:
    """Limits of a fit of a model to pixels and of its flags; the polynomial that predicts the next frame."""

    #: [1] least correlation of the pixels with the model, unless the residual is noise
    #: measurement: films of tests/kit/scenes.py: a code of 24 px at the place of another reaches 0.847 (of 12 px 0.90,
    #: blurred by 10 px 0.94); of 32568 right fits the least has 0.851, with noise of 40 gray levels, and 0.975 blurred
    least_correlation: float = 0.85
    #: [1] correlation at the best whole pixel below which a search found nothing
    #: convention: lower than that of an accepted fit, since what is sought is up to half a pixel and some blur off
    least_score: float = 0.6
    #: [px] a lost marker is sought at least this far from its last position
    reach_px: float = 8.0
    #: [1] multiple of the usual chi-square per degree of freedom up to which a residual is noise
    good_chi2: float = 3.0
    #: [1] chi-square by which the model must improve on a uniform surface
    #: statistics: five standard deviations: noise alone does so in one fit of two million
    least_signal: float = 25.0
    #: [1] largest gain relative to that of the last good fit
    #: convention: light and blur change the contrast by less from frame to frame
    largest_gain_ratio: float = 3.0
    #: [px] a fit that goes beyond it has failed
    #: physics: larger than any image that can be read, and small enough for whole numbers of 64 bits
    farthest_px: float = 1e7
    #: [1] visible share below which a marker touches the edge of the image
    #: convention: chosen; effect on a flag only
    edge_share: float = 0.98
    #: [1] share of saturated pixels from which a marker is flagged
    #: convention: chosen; effect on a flag only
    saturated_share: float = 0.01
    #: [px] path during the exposure from which a marker is flagged as blurred
    #: convention: chosen; effect on a flag only
    blurred_px: float = 1.0
    #: [sd] of chi-square for the number of pixels, beyond which a fit is poor
    #: statistics: noise alone exceeds it in one fit of 1e9
    poor_sd: float = 6.0
    #: [1] multiple of the usual chi-square beyond which a fit is poor
    #: convention: chosen; effect on a flag, and on the sd of stations
    poor_ratio: float = 1.5
    #: [1] share of the newest error in the running mean that selects the degree of the polynomial
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

"""When a fit is accepted and which flags it has: the same for a marker and for a station of a line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Limits of a fit of a model to pixels, and of its flags."""

    #: [1] share of the pixels that the model must explain, as a correlation, unless the residual is noise
    least_correlation: float = 0.85
    #: [1] multiple of the usual chi-square per degree of freedom up to which a residual is noise
    good_chi2: float = 3.0
    #: [1] chi-square by which the model must improve on a uniform surface
    #: statistics: five standard deviations: noise alone does so in one fit of two million
    least_signal: float = 25.0
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


TUNING = Tuning()

"""Slow changes of the image's scale over a record, from the spacing of the markers: zoom and focus breathing.

A change of the scale multiplies the displacement and so changes the apparent decay. Across the displacement, along the
beam, the markers move with the scale, with the camera, and with the beam, which shortens where it bends: by a
quadratic form of the displacement, whose part at twice the frequency of the vibration tells the slow part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.arrays import FloatArray
from tracker.slow_motion import MarkersInFrames, spline_matrix


@dataclass(frozen=True)
class ScaleChange:
    """Scale relative to the first frame, a cubic spline over time, and its errors.

    Attributes
    ----------
    knots : array, shape (b + 4,)
        In the time of the series.
    coefficients : array, shape (b,)
        Of the scale.
    root : array, shape (b, b)
        Coefficients of functions whose independent standard normal multiples add up to the relative error.
    """

    knots: FloatArray
    coefficients: FloatArray
    root: FloatArray

    def scale(self, time_s: FloatArray) -> FloatArray:
        """Scale at times within the record, same shape."""
        return np.asarray(spline_matrix(time_s, self.knots) @ self.coefficients)

    @property
    def note(self) -> str:
        """What the user must know of a displacement that is corrected for it."""
        change = 100.0 * float(np.ptp(self.scale(np.linspace(self.knots[0], self.knots[-1], 1001))))
        return (
            f"The scale of the image changes by {change:.2g} % over the record (camera zoom or focus breathing): "
            "displacements are corrected by the spacing of the markers, and intervals include the error of that. Fix "
            "zoom and focus."
        )

    def rate_errors(self, time_s: FloatArray, power: FloatArray) -> FloatArray:
        """Errors in 1/s of a vibration's rate of growth, shape (b,), for unit multiples of the functions of `root`.

        ``power``, shape (n,), is its squared amplitude at times `time_s`, 0 where a sample is not used: with it, least
        squares weights the slope of the relative error.
        """
        lever = power * (time_s - np.average(time_s, weights=power))
        slope = spline_matrix(time_s, self.knots).T @ lever / float(lever @ time_s)
        return np.asarray(slope @ self.root)


def scale_change(seen: MarkersInFrames) -> ScaleChange | None:
    """Change of the scale that is significant and matters; None where there is none, or markers do not show it.

    Notes
    -----
    Least squares of the positions across the displacement in a frame on those at rest gives its scale. Splines of time
    are fitted to it together with the products of the components of the vibration, and with the components themselves,
    for a beam that is bent at rest. Errors include noise at its level near the slow band, slow motion of three and more
    markers that is no change of the scale, errors of positions within the pixel, and the part of the shortening that
    its fast part does not tell, because frames are averages over their exposure.
    """
    weight = seen.across_sd**-2.0
    lever = seen.rest - np.average(seen.rest, weights=weight)
    information = float(weight @ lever**2)
    # Markers beside each other, at the same place along the beam, are no measure of the scale.
    if not information > float(lever.size):
        return None
    relative = seen.across @ (weight * lever) / information
    left = seen.across - (seen.across @ weight / weight.sum())[:, None] - relative[:, None] * lever
    slow = seen.slow_part(relative, information**-0.5, left / seen.across_sd)
    if slow is None or not slow.significant or not seen.matters(slow.coefficients):
        return None
    # At the first frame the first spline is 1 and all others are 0.
    first = 1.0 + float(slow.coefficients[0])
    # Wrong distances make the whole change wrong by one factor.
    wrong = (slow.coefficients - slow.coefficients[0]) / information
    wrong *= float(np.linalg.norm(weight * lever * seen.rest_sd))
    values, vectors = np.linalg.eigh((slow.covariance + np.outer(wrong, wrong)) / first**2)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return ScaleChange(seen.knots, (1.0 + slow.coefficients) / first, root)


def possible_zoom(seen: MarkersInFrames, distance: float) -> tuple[str, ...]:
    """A note where one marker moves slowly across its displacement: the camera moves, or the scale changes.

    Empty where a zoom about a point at this distance along the beam, in the unit of the motion, would not matter.
    """
    if seen.rest.size != 1:
        return ()
    slow = seen.slow_part(seen.across[:, 0] / distance, float(seen.across_sd[0]) / distance)
    if slow is None or not slow.significant or not seen.matters(slow.coefficients):
        return ()
    change = 100.0 * float(np.ptp(seen.splines @ slow.coefficients))
    note = (
        "The marker moves slowly along the beam: the camera moves, or its scale changes (zoom or focus breathing) and "
        f"with it the damping ratio. One marker does not show which: a zoom of {change:.2g} % about the middle of the "
        "image would move it as much. Fix camera, zoom and focus, or add a second marker along the beam."
    )
    return (note,)

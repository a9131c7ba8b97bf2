"""Errors of tracked positions that return with the motion, and therefore do not average out over a record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.arrays import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Errors that return with the motion, in standard deviations of a position in a frame."""

    #: [sd] of either quadrature of an error that returns with the motion, for each harmonic, of templates learned from
    #: 64 frames
    #: measurement: rendered recordings: up to 0.12. Where a marker crosses much of a pixel the data determine the
    #: error: a wide prior costs little
    lossless_share: float = 0.12
    #: [sd] the same of compressed frames
    #: measurement: rendered recordings as MJPG: 0.2 to 0.4
    lossy_share: float = 0.5
    #: [sd] the same of stations of a compressed line, whose error is one function of the position
    #: measurement: 25 films as MJPG: 0.31 for the period of the block, 0.14 for the shorter ones; 0.62 and 0.3 with
    #: quality 8 instead of 3, where z of damping then is 1 (docs/studies/lines.md)
    line_share: float = 0.4
    #: [px] period of the last harmonic
    #: convention: those shorter than a pixel are smaller in proportion
    finest_px: float = 0.5
    #: [sd] mean decrease of an amplitude in frames predicted from earlier ones only
    #: measurement: 243 rendered films in nine settings of x264 and x265, which files do not state
    #: (docs/studies/films.md)
    forward_shrinkage: float = 0.3
    #: [sd] the same in frames predicted from later ones, too
    #: measurement: the same films
    shrinkage: float = 0.5
    #: [sd] standard deviation about both, a slow function of the amplitude
    #: measurement: the same films
    shrinkage_sd: float = 0.4
    #: [sd] mean error out of phase in frames predicted from earlier ones only
    #: measurement: the same films
    forward_lag: float = 0.2
    #: [sd] standard deviation about it
    #: measurement: the same films
    forward_lag_sd: float = 1.5
    #: [sd] the same where frames are predicted from later ones, too; their mean is 0
    #: measurement: the same films
    lag_sd: float = 0.25
    #: [sd] of a position, below which these errors grow
    #: measurement: there encoders may repeat frames (docs/studies/films.md)
    small_amplitude: float = 5.0
    #: [sd] of a position, down to which they do
    smallest_amplitude: float = 2.0
    #: [sd] error of an amplitude in frames compressed one by one
    #: measurement: without it the intervals of 94 films of 20 px from MJPG are 1.27 times too narrow; 0.03 gives 1.15,
    #: 0.045 1.03 (docs/studies/films.md)
    lossy_shrinkage: float = 0.04
    #: [px] largest motion from frame to frame at which half of the standard deviations is left
    #: measurement: there the encoder must follow: nine settings of encoders (docs/studies/films.md)
    followed_px: float = 1.0
    #: [px] the same of the means
    #: measurement: settings differ most from 0.5 px to 1 px (docs/studies/films.md)
    mean_followed_px: float = 0.5
    #: [1] along an image axis with a smaller component of the displacement the phase of the error hardly changes
    least_component: float = 0.05


TUNING = Tuning()

# Period of the error: template noise depends on the position within the pixel, the error of a compressed frame on the
# position within its block.
PIXEL_PX, BLOCK_PX = 1.0, 8.0


@dataclass(frozen=True)
class PositionErrors:
    """Errors of k displacement channels that are functions of the marker's position, or of the amplitude.

    Attributes
    ----------
    rest_px, px_per_unit : array, shape (a, k)
        Position at rest along each image axis that the displacement has a component of, and its change with the
        displacement.
    periodic_sd : array, shape (a, k)
        Standard deviation of either quadrature of each harmonic of the error along that axis, in the unit of the
        displacement.
    period_px : float
        Period of that error.
    shrinkage, lag : array, shape (k,)
        Mean decrease of the amplitude of a vibration, and mean error out of phase, in the unit of the displacement: its
        phase is late by lag over amplitude. 0 unless the codec predicts frames from others.
    shrinkage_sd, lag_sd : array, shape (k,)
        Standard deviations of both: smooth functions of the amplitude that all channels share. 0 without compression.
    along_px : array, shape (k,)
        Px per unit of the displacement, along it.
    frame_s : float
        Frame interval.
    alike : bool
        Whether the error is the same function of the position for all channels, as for compressed stations of
        one line, which have one profile. Otherwise each channel has its own.
    predicted : bool
        Whether the codec predicts frames from others: shrinkage and lag are those of slow motions only.
    """

    rest_px: FloatArray
    px_per_unit: FloatArray
    periodic_sd: FloatArray
    period_px: float
    shrinkage: FloatArray
    lag: FloatArray
    shrinkage_sd: FloatArray
    lag_sd: FloatArray
    along_px: FloatArray
    frame_s: float
    alike: bool = False
    predicted: bool = False

    def omitted(self, channel: int, step: FloatArray, *, of_mean: bool = False) -> FloatArray:
        """Share of shrinkage and lag that is left where the displacement changes by up to `step` between frames.

        Of their sd, or `of_mean` of their mean.
        """
        if not self.predicted:
            return np.ones_like(step)
        followed_px = TUNING.mean_followed_px if of_mean else TUNING.followed_px
        return np.asarray(1.0 / (1.0 + (self.along_px[channel] * step / followed_px) ** 4))

    def growth(self, channel: int, amplitude: FloatArray) -> FloatArray:
        """Factor on shrinkage and lag, mean and sd, at small amplitudes."""
        if not self.predicted:
            return np.ones_like(amplitude)
        sd = self.shrinkage_sd[channel] / TUNING.shrinkage_sd
        return np.asarray(
            np.hypot(1.0, TUNING.small_amplitude * sd / np.maximum(amplitude, TUNING.smallest_amplitude * sd))
        )

    def periodic(self, channel: int, displacement: FloatArray) -> FloatArray:
        """Functions of time, shape (n, q), whose independent standard normal multiples add up to the periodic error.

        The displacement, shape (n,), should be the fitted one: measured displacements would add their noise.
        """
        parts = [np.zeros((displacement.size, 0))]
        places = (self.rest_px[:, channel], self.px_per_unit[:, channel], self.periodic_sd[:, channel])
        for rest, slope, sd in zip(*places, strict=True):
            parts.append(sd * harmonics(rest + slope * displacement, self.period_px))
        return np.concatenate(parts, axis=1)


def harmonics(positions_px: FloatArray, period_px: float = PIXEL_PX) -> FloatArray:
    """Weighted cosine and sine of each harmonic of the period at n positions; shape (n, q)."""
    turn = 2.0 * np.pi * positions_px / period_px
    waves = []
    for order in range(1, round(period_px / TUNING.finest_px) + 1):
        weight = min(1.0, period_px / order) / np.sqrt(period_px)
        waves += [weight * np.cos(order * turn), weight * np.sin(order * turn)]
    return np.column_stack(waves)


def position_errors(
    xy_px: FloatArray,
    sd_px: FloatArray,
    sd: FloatArray,
    direction: tuple[float, float],
    correlation: FloatArray | None = None,
    moving_sd: FloatArray | None = None,
    *,
    frame_s: float,
    lossy: bool,
    predictive: bool,
    reordered: bool = False,
    alike: bool = False,
) -> PositionErrors:
    """Errors of the displacements of k markers, in their unit.

    Parameters
    ----------
    xy_px, sd_px : array, shape (2, n, k)
        Positions in the image and their standard deviations.
    sd : array, shape (n, k)
        Standard deviations of the displacements, in their unit.
    direction : tuple of float
        Of the displacement, x right and y up.
    correlation : array, shape (n, k), or None
        Correlation of the errors of x and y in the image; None where they are independent.
    moving_sd : array, shape (k,), or None
        Standard deviations of displacements in predicted frames while a marker moves: shrinkage and lag scale with it.
        None where they are not larger than the median of `sd`.
    frame_s : float
        Frame interval.
    lossy, predictive, reordered : bool
        Whether frames are compressed with loss, whether the codec predicts frames from others, and whether also from
        later ones.
    alike : bool
        As in the result; only with `lossy`.
    """
    in_image = np.array([direction[0], -direction[1]])
    # The error of predicted frames depends on the frames before: it is no periodic function of the position.
    axes = np.flatnonzero((np.abs(in_image) > TUNING.least_component) & (not predictive))
    typical = _median(sd)
    variance_px = np.tensordot(in_image**2, sd_px**2, axes=1)
    if correlation is not None:
        variance_px = np.maximum(
            variance_px + 2.0 * in_image[0] * in_image[1] * correlation * sd_px[0] * sd_px[1], 0.0
        )
    per_px = typical / _median(np.sqrt(variance_px))
    share = TUNING.line_share if alike else TUNING.lossy_share if lossy else TUNING.lossless_share
    shrinkage, lag, shrinkage_sd, lag_sd = 0.0, 0.0, TUNING.lossy_shrinkage if lossy else 0.0, 0.0
    largest = typical if moving_sd is None else np.fmax(typical, moving_sd)
    if predictive:
        shrinkage, shrinkage_sd = (
            TUNING.shrinkage if reordered else TUNING.forward_shrinkage,
            TUNING.shrinkage_sd,
        )
        lag, lag_sd = (0.0, TUNING.lag_sd) if reordered else (TUNING.forward_lag, TUNING.forward_lag_sd)
    return PositionErrors(
        rest_px=np.array([_median(xy_px[axis]) for axis in axes]).reshape(axes.size, typical.size),
        px_per_unit=in_image[axes, None] / per_px,
        periodic_sd=share * np.abs(in_image[axes, None]) * typical,
        period_px=BLOCK_PX if lossy else PIXEL_PX,
        shrinkage=shrinkage * largest,
        lag=lag * largest,
        shrinkage_sd=shrinkage_sd * largest,
        lag_sd=lag_sd * largest,
        along_px=1.0 / per_px,
        frame_s=frame_s,
        alike=alike,
        predicted=predictive,
    )


def _median(values: FloatArray) -> FloatArray:
    """Median of each column over its finite entries; 1 where there is none."""
    return np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else 1.0 for c in values.T])

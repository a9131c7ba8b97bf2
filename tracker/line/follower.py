"""A line from frame to frame: prediction, registration of all stations, material points, search after a loss."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracker import flags
from tracker.arrays import BoolArray, FlagArray, FloatArray, GrayImage
from tracker.line import kernel, line_kernels
from tracker.line.line_kernels import AHEAD, CHANGE, DEGREES, LEARNED, LEAST_ACCEPTED, LINES, ORDER
from tracker.line.model import LineModel, empty_stations
from tracker.line.path import matched_offsets, straightened
from tracker.line.profile import spline_values

EDGE_SHARE, SATURATED_SHARE = 0.98, 0.01
# Registration is repeated from the new line where the prediction was off by this much, px, or its blur by this much.
LARGEST_MISS_PX, BLUR_MISS_PX = 0.4, 0.2
PASSES = 4
# Half sizes of the searches across the predicted line, relative to its windows, and least correlation of a match.
SEARCHES = (4.0, 16.0)
LEAST_MATCH = 0.6
LONGEST_EXTRAPOLATION = 4


class LineFrame(NamedTuple):
    """Result of a frame: flags (m,), and x, y, their sd in px and their correlation (5, m)."""

    marks: FlagArray
    out: FloatArray


class Fit(NamedTuple):
    """A registered frame: results (m, 14) about the centreline `coefs`, accepted stations, smooth displacement.

    ``moved`` is the centreline after that displacement.
    """

    coefs: FloatArray
    moved: FloatArray
    stations: kernel.Stations
    results: FloatArray
    accepted: BoolArray
    smooth: FloatArray

    @property
    def is_good(self) -> bool:
        """Whether enough stations are accepted."""
        return bool(np.count_nonzero(self.accepted) >= LEAST_ACCEPTED * self.accepted.size)


class LineFollower:
    """Follows a calibrated line through consecutive frames."""

    def __init__(self, model: LineModel) -> None:
        self.model = model
        self._line, self._profiles = model.arrays(), model.profiles()
        m = model.line.stations
        self._past = np.tile(model.start, (LINES, 1, 1))
        self._known, self._lost = 1, 0
        # Weights of the past lines in each prediction, the last of them learned, and its running error.
        self._ahead, self._error = np.zeros((LEARNED + 1, LINES)), np.linspace(1.0, 1.4, LEARNED + 1)
        self._ahead[:DEGREES, :DEGREES] = AHEAD
        self._recursion = np.zeros((ORDER, ORDER)), np.zeros(ORDER)
        self._states = np.tile([0.0, 1.0, 0.0], (m, 1))
        self.fit: Fit | None = None

    @property
    def markers(self) -> int:
        """Number of stations."""
        return self.model.line.stations

    def missing(self, flag: int) -> LineFrame:
        """Result of a frame without image; predictions move on."""
        self.fit = None
        self._advance(None)
        marks = np.full(self.markers, flag | flags.NOT_FOUND.value, dtype=np.uint32)
        return LineFrame(marks, np.full((5, self.markers), np.nan))

    def finish(self) -> None:
        """Nothing: the result of each frame is final."""

    def step(self, image: GrayImage) -> LineFrame:
        """Material points of all stations in the next frame."""
        fit = self._register(image, self._predicted())
        if not fit.is_good:
            fit = self._searched(image, fit)
        if not fit.is_good:
            # Nothing proves that the few accepted stations are not background.
            return self.missing(0)
        self.fit = fit
        self._advance(fit.moved)
        good = fit.accepted
        self._states[good] = fit.results[good, : kernel.STATE]
        # What is not smooth along the line persists, such as the shape of a bent ruler.
        rest = self._rest(fit)
        self._states[:, 0] = np.where(good, rest, 0.0)
        return self._output(fit, rest)

    def moved(self, coefs: FloatArray, smooth: FloatArray) -> FloatArray:
        """Material points of a line after a smooth displacement along its normals; see `line_kernels.moved`."""
        out = np.empty_like(coefs)
        line_kernels.moved(self._line, coefs, smooth, out)
        return out

    def _rest(self, fit: Fit) -> FloatArray:
        """Displacement of each station about the smooth line; NaN where it was not fitted."""
        smooth = np.empty(self.markers)
        line_kernels.at_stations(self._line, fit.smooth, smooth)
        return np.asarray(fit.results[:, kernel.SHIFT] - smooth)

    def _predicted(self) -> FloatArray:
        """The next line, as predicted by what was the best of late."""
        # After a long loss, the line is expected where it was last.
        usable = self._predictions() if self._lost <= LONGEST_EXTRAPOLATION else 1
        best = int(np.argmin(self._error[:usable]))
        coefs: FloatArray = np.empty_like(self._past[0])
        line_kernels.weighted(self._ahead[best], self._past, coefs)
        return coefs

    def _predictions(self) -> int:
        """Number of predictions for which enough lines are known."""
        return LEARNED + 1 if self._known > LINES else min(self._known, DEGREES)

    def _blur(self, coefs: FloatArray) -> FloatArray:
        """Path of each station along its normal during the exposure, for a line in the present frame; shape (m,)."""
        out = np.zeros(self.markers)
        if self.model.exposure_share > 0.0 and self._known > 1:
            lines, change = np.concatenate([coefs[None], self._past[:-1]]), np.empty_like(coefs)
            line_kernels.weighted(CHANGE[min(self._known, DEGREES - 1)], lines, change)
            line_kernels.path_along_normals(self._line, coefs, change, self.model.exposure_share, out)
        return out

    def _advance(self, coefs: FloatArray | None) -> None:
        """Add the line of a frame to the past; its prediction where it was lost."""
        if coefs is None:
            self._lost += 1
            coefs = self._predicted()
        else:
            if self._lost == 0:
                line_kernels.judge_predictions(
                    self._line, self._past, self._ahead, self._predictions(), coefs, self._error
                )
                if self._known >= LINES:
                    line_kernels.learn_recursion(self._past, coefs, *self._recursion, self._ahead[LEARNED])
            self._known = min(self._known + 1, LINES + 1) if self._lost <= LONGEST_EXTRAPOLATION else 1
            self._lost = 0
        self._past[1:] = self._past[:-1]
        self._past[0] = coefs

    def _register(self, image: GrayImage, coefs: FloatArray) -> Fit:
        """Register all stations, repeated from the line found where the guess was not close."""
        m = self.markers
        blur, states, rest = self._blur(coefs), self._states.copy(), self._states[:, 0]
        for _ in range(PASSES):
            fit = Fit(
                coefs,
                np.empty_like(coefs),
                empty_stations(m),
                np.empty((m, kernel.RESULT)),
                np.empty(m, dtype=np.bool_),
                np.empty(len(coefs)),
            )
            miss = line_kernels.register_about(
                image, self._line, self._profiles, coefs, blur, states, rest, *fit[2:]
            )
            if not np.isfinite(miss):
                return fit
            line_kernels.moved(self._line, coefs, fit.smooth, fit.moved)
            coefs = fit.moved
            before, blur = blur, self._blur(coefs)
            if miss < LARGEST_MISS_PX and np.abs(blur - before).max() < BLUR_MISS_PX:
                return fit
            states[fit.accepted] = fit.results[fit.accepted, : kernel.STATE]
            states[:, 0] = rest
        return fit

    def _searched(self, image: GrayImage, failed: Fit) -> Fit:
        """The best fit after a search of the whole line across its prediction, in growing windows."""
        line, half = self.model.line, self.model.half_across_px
        width = int(np.ceil(half))
        across = np.arange(-width, width + 1, dtype=np.float64)
        coefs, _, first, _ = self._profiles
        profiles = np.stack([spline_values(c, first, across) for c in coefs])
        best = failed
        for factor in SEARCHES:
            for aim in (failed.coefs, self._past[0]):
                reach = int(factor * half) + width
                levels = straightened(image, line.at_stations(aim), reach, 0.5 * line.spacing_px)
                offsets, score = matched_offsets(levels, profiles, line.spacing_px)
                found = score >= LEAST_MATCH
                if np.count_nonzero(found) < LEAST_ACCEPTED * self.markers:
                    continue
                fit = self._register(image, self.moved(aim, line.smoothed(offsets, found)))
                if np.count_nonzero(fit.accepted) > np.count_nonzero(best.accepted):
                    best = fit
                if best.is_good:
                    return best
        return best

    def _output(self, fit: Fit, rest: FloatArray) -> LineFrame:
        """Positions of the material points with sd and flags; NaN for stations that are not accepted."""
        curve, m = empty_stations(self.markers), self.markers
        line_kernels.place_stations(self._line, fit.moved, fit.stations.blur, curve)
        results, good = fit.results, fit.accepted
        normals = np.stack([-curve.tangents[:, 1], curve.tangents[:, 0]])
        chi2, pixels = results[:, kernel.CHI2], np.maximum(results[:, kernel.PIXELS], 1.0)
        limit = np.maximum(1.0 + 6.0 * np.sqrt(2.0 / pixels), 1.5 * self.model.typical_chi2)
        poor = chi2 > limit
        # Chi-square of few pixels scatters: its own value is used only where it is clearly large.
        enlarged = np.sqrt(np.where(poor, chi2, self.model.typical_chi2))
        out, marks = np.empty((5, m)), np.zeros(m, dtype=np.uint32)
        out[:2] = curve.points.T + rest * normals
        out[2:4] = np.abs(normals) * (results[:, kernel.SD] * enlarged)
        # Only the component along the normal is measured: the errors of x and y are one and the same.
        out[4] = np.sign(normals[0] * normals[1])
        out[:, ~good] = np.nan
        marks[~good] = flags.NOT_FOUND.value
        marks[good & (results[:, kernel.SEEN] < EDGE_SHARE)] |= flags.EDGE.value
        marks[good & (results[:, kernel.SATURATED] > SATURATED_SHARE)] |= flags.SATURATED.value
        marks[good & (fit.stations.blur > 1.0)] |= flags.BLURRED.value
        marks[good & poor] |= flags.POOR_FIT.value
        return LineFrame(marks, out)

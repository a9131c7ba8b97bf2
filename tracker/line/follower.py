"""A line from frame to frame: prediction, registration of all stations, and search for the path after a loss."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numba import njit

from tracker import flags
from tracker.acceptance import AHEAD
from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import BoolArray, FlagArray, FloatArray, GrayImage, IntArray
from tracker.line import kernel
from tracker.line import stations as line_kernels
from tracker.line.model import CurveAt, LineModel, empty_stations
from tracker.line.profile import spline_values
from tracker.line.stations import CHANGE, DEGREES, LEARNED, LEAST_ACCEPTED, LINES, ORDER


@dataclass(frozen=True)
class Tuning:
    """Paths through an image, following a line, and its flags."""

    #: [1] of a path against the guessed curve
    largest_slope: float = 0.8
    #: [1] cost of each px by which a path changes its slope, relative to a typical score
    bend_cost: float = 0.15
    #: [px] on either side of an edge whose levels are compared
    edge_reach_px: int = 3
    #: [1] a strip is preferred to an edge if its score is at least this share of the edge's
    #: convention: each side of a strip is an edge
    strip_share: float = 0.6
    #: [1] contrast relative to the known profile from which a match counts fully
    #: convention: the noise of a plain surface correlates with anything
    match_gain: float = 0.4
    #: [1] as `bend_cost`, for the search of a known profile
    match_bend_cost: float = 0.05
    #: [px] registration is repeated from the new line where the prediction was off by this much
    largest_miss_px: float = 0.4
    #: [1] of a registration, at most
    passes: int = 4
    #: [1] half size of the first search across the predicted line, relative to its windows; the second is four times as
    #: wide
    near_search: float = 4.0
    #: [1] quantile of the scores that is typical of a path
    typical_score: float = 0.95
    #: [px] of width up to which a wider mean is preferred, by its signal-to-noise ratio
    averaged_px: int = 12


TUNING = Tuning()

STRIP_WIDTHS_PX = (2, 3, 4, 6, 8, 11, 15, 20, 28, 40)


def straightened(image: GrayImage, curve: CurveAt, reach_px: int, along_px: float) -> FloatArray:
    """Gray levels across a curve, shape (m, 2 reach + 1), averaged over `along_px`; the border repeats outside."""
    across = np.arange(-reach_px, reach_px + 1, dtype=np.float64)
    total = np.zeros((len(curve.points), across.size))
    source = image.astype(np.float32)
    parts = (-0.5, 0.0, 0.5)
    for part in parts:
        start = curve.points + part * along_px * curve.tangents
        x = start[:, :1] + across * curve.normals[:, :1]
        y = start[:, 1:] + across * curve.normals[:, 1:]
        total += cv2.remap(
            source,
            x.astype(np.float32),
            y.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
    return np.asarray(total / len(parts))


@njit(cache=True, nogil=True)
def best_path(score: FloatArray, steepest: int, cost: float) -> IntArray:
    """Path of the largest total score, one column for each row; shape (m,).

    From row to row it moves by at most `steepest` columns; each column of it costs `cost`. Columns with a score of
    -inf are forbidden.
    """
    rows, columns = score.shape
    total = score.copy()
    came = np.zeros((rows, columns), dtype=np.int64)
    for k in range(1, rows):
        for j in range(columns):
            best, where = -np.inf, j
            for i in range(max(j - steepest, 0), min(j + steepest, columns - 1) + 1):
                value = total[k - 1, i] - cost * abs(i - j)
                if value > best:
                    best, where = value, i
            total[k, j] += best
            came[k, j] = where
    path = np.empty(rows, dtype=np.int64)
    path[rows - 1] = np.argmax(total[rows - 1])
    for k in range(rows - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    return path


@dataclass(frozen=True)
class FoundPath:
    """A path: offsets along the normals of the guess (m,), what it follows, its width, and its contrast (m,).

    `width_px` is 0 for an edge; the contrast is in gray levels.
    """

    offsets_px: FloatArray
    feature: Literal["strip", "edge"]
    width_px: float
    contrast: FloatArray


def find_path(
    across: FloatArray, spacing_px: float, feature: Literal["strip", "edge", "auto"], ends_px: float
) -> FoundPath:
    """The strip or edge of the largest contrast in a straightened image, from end to end of the guess.

    At both ends the path is within `ends_px` of the guess, farther in between.
    """
    m, columns = across.shape
    reach = columns // 2
    from_end = np.minimum(np.arange(m) + 0.5, m - 0.5 - np.arange(m)) * spacing_px
    allowed = (
        np.abs(np.arange(columns) - reach)[None, :] <= ends_px + TUNING.largest_slope * from_end[:, None]
    )
    found: dict[str, FoundPath] = {}
    merit: dict[str, float] = {}
    for width in (*STRIP_WIDTHS_PX, 0):
        kind: Literal["strip", "edge"] = "strip" if width else "edge"
        if feature not in (kind, "auto") or 2 * width + 6 > columns:
            continue
        response = _strip_response(across, width) if width else _edge_response(across)
        for sign in (1.0, -1.0):
            score = np.where(allowed, np.maximum(sign * response, 0.0), -np.inf)
            cost = TUNING.bend_cost * float(np.quantile(score[np.isfinite(score)], TUNING.typical_score))
            path = best_path(score, int(np.ceil(TUNING.largest_slope * spacing_px)), cost)
            contrast = score[np.arange(m), path]
            # Wider means average more pixels: the signal-to-noise ratio selects the width.
            value = (
                float(np.mean(contrast)) * np.sqrt(min(width, TUNING.averaged_px))
                if width
                else float(np.mean(contrast))
            )
            if value > merit.get(kind, 0.0):
                merit[kind] = value
                found[kind] = FoundPath((path - reach).astype(np.float64), kind, float(width), contrast)
    if not found:
        return FoundPath(np.zeros(m), "edge", 0.0, np.zeros(m))
    if "strip" in found and "edge" in found:
        strip, edge = found["strip"], found["edge"]
        return strip if strip.contrast.mean() >= TUNING.strip_share * edge.contrast.mean() else edge
    return next(iter(found.values()))


def _means(across: FloatArray, count: int) -> FloatArray:
    """Means over `count` columns; column j of the result begins at column j of the image."""
    total = np.cumsum(np.pad(across, ((0, 0), (1, 0))), axis=1)
    return np.asarray((total[:, count:] - total[:, :-count]) / count)


def _strip_response(across: FloatArray, width: int) -> FloatArray:
    """Smaller of the differences between a strip of this width and the surface on either side of it."""
    flank = max(2, width // 2)
    margin = width // 2 + 1 + flank
    padded = np.pad(across, ((0, 0), (margin + 1, margin + 1)), mode="edge")
    columns = np.arange(across.shape[1]) + margin + 1
    inner, outer = _means(padded, width), _means(padded, flank)
    start = columns - (width - 1) // 2
    one = inner[:, start] - outer[:, start - 1 - flank]
    other = inner[:, start] - outer[:, start + width + 1]
    same = np.sign(one) == np.sign(other)
    return np.asarray(np.where(same, np.sign(one) * np.minimum(np.abs(one), np.abs(other)), 0.0))


def _edge_response(across: FloatArray) -> FloatArray:
    """Difference of the surfaces on the side of the normal and on the other."""
    reach = TUNING.edge_reach_px
    padded = np.pad(across, ((0, 0), (reach + 1, reach + 1)), mode="edge")
    means = _means(padded, reach)
    columns = np.arange(across.shape[1]) + reach + 1
    return np.asarray(means[:, columns + 1] - means[:, columns - reach])


def centred(image: GrayImage, points_px: FloatArray, path: FoundPath, flank_px: float) -> FloatArray:
    """Points near a strip, moved to the centre of its contrast up to `flank_px` beside it; of an edge as they are."""
    if path.feature == "edge":
        return points_px
    tangents = np.gradient(points_px, axis=0)
    spacing = np.linalg.norm(tangents, axis=1)
    curve = CurveAt(points_px, tangents / spacing[:, None], np.zeros(len(points_px)), spacing)
    reach = int(np.ceil(0.5 * path.width_px + flank_px))
    levels = straightened(image, curve, reach, 0.5 * float(np.median(spacing)))
    across = np.arange(-reach, reach + 1.0)
    outer = np.abs(across) > reach - 2
    excess = levels - levels[:, outer].mean(axis=1, keepdims=True)
    excess *= np.sign(np.median(excess[:, reach]))
    # Half of the contrast is far above noise and texture.
    excess = np.maximum(excess - 0.5 * np.max(excess, axis=1, keepdims=True), 0.0)
    off = np.sum(excess * across, axis=1) / np.maximum(np.sum(excess, axis=1), 1e-9)
    return np.asarray(points_px + off[:, None] * curve.normals)


def matched_offsets(
    across: FloatArray, profiles: FloatArray, spacing_px: float
) -> tuple[FloatArray, FloatArray]:
    """Offset of each station at which a known profile is found, all stations together, and its correlation there.

    Parameters
    ----------
    across : array, shape (m, columns)
        Straightened image, in steps of a px.
    profiles : array, shape (m, width)
        Profile at each station in steps of a px, of odd width; the line is in the middle.
    """
    width = profiles.shape[1]
    half, reach = width // 2, across.shape[1] // 2
    windows = np.lib.stride_tricks.sliding_window_view(across, width, axis=1)
    centred = profiles - profiles.mean(axis=1, keepdims=True)
    product = np.einsum("mjw,mw->mj", windows, centred)
    spread = np.maximum(windows.var(axis=2) * width, 1e-9)
    norm = np.sum(centred**2, axis=1)[:, None]
    correlation = product / np.sqrt(spread * norm)
    # Contrast must be similar too: the noise of a plain surface correlates with anything.
    gain = product / norm
    score = np.clip(correlation, 0.0, 1.0) * np.clip(gain / TUNING.match_gain, 0.0, 1.0)
    path = best_path(score, int(np.ceil(TUNING.largest_slope * spacing_px)), TUNING.match_bend_cost)
    return (path + half - reach).astype(np.float64), score[np.arange(len(path)), path]


class LineFrame(NamedTuple):
    """Result of a frame; see `tracker.markers.FrameResult`."""

    marks: FlagArray
    out: FloatArray
    correlation: FloatArray


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
        return LineFrame(marks, np.full((4, self.markers), np.nan), np.full(self.markers, np.nan))

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
        usable = self._predictions() if self._lost <= ACCEPTANCE.longest_extrapolation else 1
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
            self._known = (
                min(self._known + 1, LINES + 1) if self._lost <= ACCEPTANCE.longest_extrapolation else 1
            )
            self._lost = 0
        self._past[1:] = self._past[:-1]
        self._past[0] = coefs

    def _register(self, image: GrayImage, coefs: FloatArray) -> Fit:
        """Register all stations, repeated from the line found where the guess was not close."""
        m = self.markers
        blur, states, rest = self._blur(coefs), self._states.copy(), self._states[:, 0]
        for _ in range(TUNING.passes):
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
            if miss < TUNING.largest_miss_px and np.abs(blur - before).max() < kernel.LEAST_BLUR_PX:
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
        for factor in (TUNING.near_search, 4.0 * TUNING.near_search):
            for aim in (failed.coefs, self._past[0]):
                reach = int(factor * half) + width
                levels = straightened(image, line.at_stations(aim), reach, 0.5 * line.spacing_px)
                offsets, score = matched_offsets(levels, profiles, line.spacing_px)
                found = score >= ACCEPTANCE.least_score
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
        limit = np.maximum(
            1.0 + ACCEPTANCE.poor_sd * np.sqrt(2.0 / pixels), ACCEPTANCE.poor_ratio * self.model.typical_chi2
        )
        poor = chi2 > limit
        # Chi-square of few pixels scatters: its own value is used only where it is clearly large.
        enlarged = np.sqrt(np.where(poor, chi2, self.model.typical_chi2))
        out, marks = np.empty((4, m)), np.zeros(m, dtype=np.uint32)
        out[:2] = curve.points.T + rest * normals
        out[2:] = np.abs(normals) * (results[:, kernel.SD] * enlarged)
        out[:, ~good] = np.nan
        marks[~good] = flags.NOT_FOUND.value
        marks[good & (results[:, kernel.SEEN] < ACCEPTANCE.edge_share)] |= flags.EDGE.value
        marks[good & (results[:, kernel.SATURATED] > ACCEPTANCE.saturated_share)] |= flags.SATURATED.value
        marks[good & (fit.stations.blur > ACCEPTANCE.blurred_px)] |= flags.BLURRED.value
        marks[good & poor] |= flags.POOR_FIT.value
        # Only the component along the normal is measured: the errors of x and y are one and the same.
        return LineFrame(marks, out, np.where(good, np.sign(normals[0] * normals[1]), np.nan))

"""Following the markers from frame to frame: predicted windows, registration, recovery, flags."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tracker import flags
from tracker.find.finder import MarkerFinder, Sighting
from tracker.predict import Predictor
from tracker.registration import kernel
from tracker.registration.blur import (
    SMALLEST_PX,
    BlurBank,
    exposed_path_px,
    path_length_px,
    seen_from_marker,
)
from tracker.registration.model import Camera, MarkerModel, contrast_state, reach_px, register, stride
from tracker.registration.together import (
    FOLLOWED,
    LIMITS,
    UNTOUCHED,
    all_plain,
    believed,
    correlation,
    follow_plain,
    take_over,
)
from tracker.search import coarse_search
from tracker.series import FloatArray
from tracker.source import GrayImage

# A fit is believed when the template explains this share of the picture, or its residual is the noise's.
LEAST_CORRELATION = 0.85
# After a search the neighbour with a similar print is the danger.
LEAST_CORRELATION_AFTER_SEARCH = 0.92
GOOD_CHI2 = 3.0
# Chi-square by which the template must beat an even surface: five standard deviations.
LEAST_SIGNAL = 25.0
# A fit below this correlation makes an ArUco marker's shape be looked at anew, at most every so many frames.
REFRESH_CORRELATION = 0.97
REFRESH_EVERY = 5
# Detection in the whole picture is slow: after this many frames without success it is tried now and then.
PATIENCE = 200
IMPATIENT_EVERY = 10
# Corners alone are good to about this: the sd of a position that no fit confirms.
DETECTION_SD_PX = 0.5
SEEN_SHARE = 0.98
LEAST_SEEN_SHARE = 0.45
RULES = np.array([LEAST_SEEN_SHARE, LEAST_SIGNAL, LEAST_CORRELATION, GOOD_CHI2, REFRESH_CORRELATION])
BITS = np.array(
    [f.value for f in (flags.NOT_FOUND, flags.EDGE, flags.SATURATED, flags.BLURRED, flags.POOR_FIT)],
    dtype=np.uint32,
)


@dataclass(frozen=True)
class FrameResult:
    """Positions of m markers in one frame; NaN and NOT_FOUND where a marker is missing.

    Where the exposure is known, those of a frame in which markers are blurred are completed in place by the next
    step, or by `Follower.finish`: the path during an exposure is known from the frames on both sides.

    Attributes
    ----------
    x_px, y_px, sd_x_px, sd_y_px : array, shape (m,)
    flags : uint32 array, shape (m,)
    """

    x_px: FloatArray
    y_px: FloatArray
    sd_x_px: FloatArray
    sd_y_px: FloatArray
    flags: NDArray[np.uint32]


@dataclass(frozen=True)
class _Pending:
    """A frame whose blur is known better once the next one was followed."""

    image: GrayImage
    results: FloatArray
    marks: NDArray[np.uint32]
    warps: FloatArray
    motion: FloatArray
    shown: FrameResult


class _Shapes:
    """How the markers' templates lie in the picture, as the compiled calls take it."""

    def __init__(self, models: tuple[MarkerModel, ...]) -> None:
        self._templates = [m.template for m in models]
        self._largest_shift = [4.0 + 0.2 * m.sighting.size_px for m in models]
        grids = [t.grid for t in self._templates]
        self.coefs = np.concatenate([coefs.ravel() for coefs, _ in grids])
        self.support = np.concatenate([support.ravel() for _, support in grids])
        sizes = [support.size for _, support in grids]
        first = np.concatenate([[0], np.cumsum(sizes[:-1])])
        self.places = np.array(
            [
                (f, *support.shape, 1, m.with_angle)
                for f, m, (_, support) in zip(first, models, grids, strict=True)
            ],
            dtype=np.int64,
        )
        self.warps = np.array([m.warp for m in models])
        self.shapes = np.zeros((len(models), 3))
        for k, model in enumerate(models):
            self.set_warp(k, model.warp)
        self.centres_uv = np.array([m.centre_uv for m in models])
        usual = [max(1.0, m.chi2) if np.isfinite(m.chi2) else 1.0 for m in models]
        self.limits = np.array(
            [(u, m.sighting.size_px, m.sighting.kind == "aruco") for u, m in zip(usual, models, strict=True)],
            dtype=np.float64,
        ).reshape(-1, LIMITS)

    def set_warp(self, k: int, warp: FloatArray) -> None:
        """Let marker k look otherwise from now on."""
        template = self._templates[k]
        self.warps[k] = warp
        self.places[k, 3] = stride(template, warp)
        self.shapes[k] = template.oversampling, reach_px(template, warp), self._largest_shift[k]


def _blurs(motion: FloatArray) -> list[FloatArray]:
    """Motions with which a marker is looked for: the foretold one, and none, as a lost one may have stopped."""
    still = np.zeros(2)
    return [motion, still] if np.hypot(motion[0], motion[1]) >= SMALLEST_PX else [still]


class Follower:
    """Follows calibrated markers through a recording, one frame after the other.

    Parameters
    ----------
    models : tuple of MarkerModel, length m
    camera : Camera
    finder : MarkerFinder
        Asked again for what was lost.
    exposure_share : float
        Exposure time over the time between frames; 0 when it is not known. Above 0, the calibration's frames must
        be the first ones that are followed, for their motion is where the blur starts from.
    """

    def __init__(
        self, models: tuple[MarkerModel, ...], camera: Camera, finder: MarkerFinder, exposure_share: float
    ) -> None:
        self._models = models
        self._camera = camera
        self._noise = camera.noise.as_array()
        self._finder = finder
        self._exposure_share = exposure_share
        self._banks = [BlurBank(m.template, m.known) for m in models]
        self._shapes = _Shapes(models)
        m = len(models)
        # Last good state of each marker: NaN where there is none, and its last gain, which stays.
        self._states = np.full((m, kernel.STATE), np.nan)
        self._gains = np.ones(m)
        self._lost = np.zeros(m, dtype=np.int64)
        self._since_refresh = np.full(m, REFRESH_EVERY)
        self._predictor = Predictor(m)
        self._pending: _Pending | None = None
        for k, model in enumerate(models):
            first = model.states[:3, :2]
            seen = model.states[np.all(np.isfinite(model.states[:, :2]), axis=1), :2]
            if exposure_share > 0.0 and first.shape == (3, 2) and np.all(np.isfinite(first)):
                # A blurred first frame is told by its motion alone.
                self._predictor.start_moving(k, first)
                self._states[k] = np.nanmedian(model.states, axis=0)
                self._states[k, :2] = first[0]
            elif len(seen):
                self._predictor.start(k, seen[0])
            else:
                self._predictor.start(k, np.array([model.sighting.x_px, model.sighting.y_px]))

    @property
    def markers(self) -> int:
        """How many markers are followed."""
        return len(self._models)

    def missing(self, flag: int) -> FrameResult:
        """The row of a frame without picture; the windows move on."""
        m = len(self._models)
        self._predictor.update(np.full((m, 2), np.nan))
        self._complete()
        nothing = np.full(m, np.nan)
        return FrameResult(
            nothing, nothing, nothing, nothing, np.full(m, flag | flags.NOT_FOUND.value, dtype=np.uint32)
        )

    def step(self, image: GrayImage) -> FrameResult:
        """Positions of all markers in the next frame.

        Those of the frame before are bettered in place where it was blurred: a result stands one frame later.
        """
        m = len(self._models)
        aims, motion, results = np.empty((m, 2)), np.empty((m, 2)), np.empty((m, kernel.RESULT))
        marks, out = np.zeros(m, dtype=np.uint32), np.empty((4, m))
        self._since_refresh += 1
        way = self._follow_plain(image, aims, motion, results, marks, out)
        if way == FOLLOWED:
            self._complete()
            return FrameResult(out[0], out[1], out[2], out[3], marks)
        if way == UNTOUCHED:
            aims, motion = self._predictor.predict()
            motion *= self._exposure_share
            for k in range(m):
                results[k] = self._register(image, k, aims[k], motion[k])
        if not all_plain(results, self._states, self._shapes.limits, RULES):
            for k in range(m):
                if not self._believed(k, results[k]):
                    results[k], marks[k] = self._recover_nearby(image, k, aims[k], motion[k])
            self._recover_by_detection(image, results, marks, motion)
            self._drop_coinciding(results, aims)
        own_marks, warps = marks.copy(), self._shapes.warps.copy()
        shown = self._finish(results, marks, motion)
        self._complete()
        if self._exposure_share > 0.0 and np.hypot(motion[:, 0], motion[:, 1]).max() >= SMALLEST_PX:
            self._pending = _Pending(image, results, own_marks, warps, motion, shown)
        return shown

    def finish(self) -> None:
        """Complete the last frame, with the motion that its past makes likely."""
        self._predictor.update(np.full((len(self._models), 2), np.nan))
        self._complete()

    def _complete(self) -> None:
        """Fit the frame before the latest anew where it is blurred, along the path that its neighbours tell."""
        pending, self._pending = self._pending, None
        if pending is None:
            return
        motion, bend = self._predictor.passed()
        for k, model in enumerate(self._models):
            path = exposed_path_px(motion[k], bend[k], self._exposure_share)
            first, warp = pending.results[k], pending.warps[k]
            if not np.all(np.isfinite(first[: kernel.STATE])) or not path_length_px(path) >= SMALLEST_PX:
                continue
            template = self._banks[k].exact(seen_from_marker(path, warp, first[kernel.ANGLE]))
            again = register(
                pending.image,
                first[: kernel.STATE],
                warp,
                template,
                self._camera,
                reach=reach_px(template, warp),
                with_angle=model.with_angle,
                max_shift_px=self._shapes.shapes[k, 2],
            )
            if believed(again, first[kernel.GAIN], self._shapes.limits[k, 0], RULES, LEAST_CORRELATION):
                pending.results[k] = again
        motion = motion * self._exposure_share
        self._show_again(pending, np.where(np.isfinite(motion), motion, pending.motion))

    def _show_again(self, pending: _Pending, motion: FloatArray) -> None:
        shown = pending.shown
        out = self._taken_over(
            pending.results, pending.marks, motion, pending.warps, self._states.copy(), self._lost.copy()
        )[0]
        for column, values in zip((shown.x_px, shown.y_px, shown.sd_x_px, shown.sd_y_px), out, strict=True):
            column[:] = values
        # What others have marked the frame with stays.
        shown.flags[:] = (shown.flags & ~np.bitwise_or.reduce(BITS)) | pending.marks

    def _follow_plain(
        self,
        image: GrayImage,
        aims: FloatArray,
        motion: FloatArray,
        results: FloatArray,
        marks: NDArray[np.uint32],
        out: FloatArray,
    ) -> int:
        shapes = self._shapes
        way = follow_plain(
            image,
            self._predictor.memory,
            self._states,
            self._gains,
            self._lost,
            shapes.warps,
            shapes.coefs,
            shapes.support,
            shapes.places,
            shapes.shapes,
            shapes.centres_uv,
            shapes.limits,
            self._noise,
            self._camera.saturation,
            self._exposure_share,
            SMALLEST_PX if self._exposure_share > 0.0 else np.inf,
            RULES,
            SEEN_SHARE,
            BITS,
            aims,
            motion,
            results,
            marks,
            out,
        )
        return int(way)

    def _start(self, image: GrayImage, k: int, aim: FloatArray) -> FloatArray:
        """State from which a fit starts at `aim`."""
        model = self._models[k]
        if np.isfinite(self._states[k, kernel.GAIN]):
            return np.concatenate([aim, self._states[k, 2:]])
        if model.source == "learned":
            return np.array([aim[0], aim[1], 0.0, 1.0, 0.0])
        return contrast_state(image, replace(model.sighting, x_px=float(aim[0]), y_px=float(aim[1])))

    def _register(
        self, image: GrayImage, k: int, aim: FloatArray, motion: FloatArray, warp: FloatArray | None = None
    ) -> FloatArray:
        """Register one marker, with another warp than its own where one is given (and then at angle 0)."""
        model = self._models[k]
        start = self._start(image, k, aim)
        if warp is None:
            warp = self._shapes.warps[k]
        elif model.sighting.kind == "aruco":
            start[2] = 0.0
        template = model.template
        if np.hypot(motion[0], motion[1]) >= SMALLEST_PX:
            path = seen_from_marker(np.stack([motion, np.zeros(2)]), warp, start[2])
            template = self._banks[k].get(path[0])
        return register(
            image,
            start,
            warp,
            template,
            self._camera,
            reach=reach_px(template, warp),
            with_angle=model.with_angle,
            max_shift_px=self._shapes.shapes[k, 2],
        )

    def _believed(self, k: int, result: FloatArray, least: float = LEAST_CORRELATION) -> bool:
        return bool(believed(result, self._states[k, 3], self._shapes.limits[k, 0], RULES, least))

    def _recover_nearby(
        self, image: GrayImage, k: int, aim: FloatArray, motion: FloatArray
    ) -> tuple[FloatArray, int]:
        """Search a window that grows with the time since the loss; a failed result when nothing fits."""
        nothing = np.full(kernel.RESULT, np.nan)
        nothing[kernel.CONVERGED] = 0.0
        model = self._models[k]
        wider = 8.0 + 0.5 * model.sighting.size_px + 4.0 * min(self._lost[k], 15)
        for centre in (aim, self._states[k, :2]):
            if not np.all(np.isfinite(centre)):
                continue
            warp, gain = self._shapes.warps[k], float(self._gains[k])
            place = coarse_search(image, centre, wider, model.template, warp, gain)
            if place is None:
                continue
            for blur in _blurs(motion):
                result = self._register(image, k, place, blur)
                if self._believed(k, result, LEAST_CORRELATION_AFTER_SEARCH):
                    return result, flags.RECOVERED.value
        return nothing, 0

    def _recover_by_detection(
        self, image: GrayImage, results: FloatArray, marks: NDArray[np.uint32], motion: FloatArray
    ) -> None:
        """Ask the finder for markers that are lost, and for the shape of those that fit badly."""
        wanted = []
        for k, model in enumerate(self._models):
            lost = results[k][kernel.CONVERGED] == 0.0
            ugly = (
                model.sighting.kind == "aruco"
                and correlation(results[k]) < REFRESH_CORRELATION
                and results[k][kernel.CHI2] > GOOD_CHI2 * max(1.0, model.chi2)
                and self._since_refresh[k] >= REFRESH_EVERY
            )
            patient = self._lost[k] < PATIENCE or self._lost[k] % IMPATIENT_EVERY == 0
            if (lost and patient) or ugly:
                wanted.append(k)
        if not wanted:
            return
        by_name = {self._models[k].sighting.name: k for k in wanted}
        for sighting in self._finder.again(image, tuple(self._last_seen(k) for k in wanted)):
            k = by_name[sighting.name]
            results[k], marks[k] = self._reshape(image, k, sighting, results[k], int(marks[k]), motion[k])
        self._since_refresh[wanted] = 0

    def _last_seen(self, k: int) -> Sighting:
        sighting, state = self._models[k].sighting, self._states[k]
        if np.isnan(state[0]):
            return sighting
        return replace(sighting, x_px=float(state[0]), y_px=float(state[1]))

    def _reshape(
        self,
        image: GrayImage,
        k: int,
        sighting: Sighting,
        before: FloatArray,
        mark: int,
        motion: FloatArray,
    ) -> tuple[FloatArray, int]:
        """Register with the shape of a detection; its corners alone when no fit confirms them."""
        was_lost = before[kernel.CONVERGED] == 0.0
        model = self._models[k]
        warp = model.refine @ sighting.warp if sighting.kind == "aruco" else self._shapes.warps[k].copy()
        place = np.array([sighting.x_px, sighting.y_px])
        tried = [self._register(image, k, place, blur, warp) for blur in _blurs(motion)]
        result = max(tried, key=correlation)
        if self._believed(k, result) and (was_lost or correlation(result) > correlation(before)):
            self._shapes.set_warp(k, warp)
            return result, mark | (flags.RECOVERED.value if was_lost else 0)
        if not was_lost or sighting.kind != "aruco":
            return before, mark
        corners_only = np.full(kernel.RESULT, np.nan)
        corners_only[[kernel.X, kernel.Y, kernel.SD_X, kernel.SD_Y]] = (
            *place,
            DETECTION_SD_PX,
            DETECTION_SD_PX,
        )
        corners_only[[kernel.CONVERGED, kernel.CHI2, kernel.SEEN, kernel.SATURATED]] = (1.0, 1.0, 1.0, 0.0)
        self._shapes.set_warp(k, warp)
        self._states[k] = np.nan
        return corners_only, mark | flags.RECOVERED.value | flags.POOR_FIT.value

    def _drop_coinciding(self, results: FloatArray, aims: FloatArray) -> None:
        """Two markers in one place: the one that jumped farther is the wrong one."""
        places = results[:, :2].copy()
        for k in range(len(results)):
            for other in range(k):
                near = 0.4 * self._models[k].sighting.size_px
                if np.hypot(*(places[k] - places[other])) < near:
                    jumps = np.linalg.norm(places[[k, other]] - aims[[k, other]], axis=1)
                    loser = k if jumps[0] >= jumps[1] else other
                    results[loser] = np.nan
                    results[loser, kernel.CONVERGED] = 0.0
                    places[loser] = np.nan

    def _finish(self, results: FloatArray, marks: NDArray[np.uint32], motion: FloatArray) -> FrameResult:
        out, places = self._taken_over(results, marks, motion, self._shapes.warps, self._states, self._lost)
        self._gains = np.where(np.isfinite(self._states[:, 3]), self._states[:, 3], self._gains)
        self._predictor.update(places)
        return FrameResult(out[0], out[1], out[2], out[3], marks)

    def _taken_over(
        self,
        results: FloatArray,
        marks: NDArray[np.uint32],
        motion: FloatArray,
        warps: FloatArray,
        states: FloatArray,
        lost: NDArray[np.int64],
    ) -> tuple[FloatArray, FloatArray]:
        """Positions with sd, shape (4, m), and registered places, shape (m, 2); see `take_over`."""
        m = len(results)
        out, places = np.empty((4, m)), np.empty((m, 2))
        shapes = self._shapes
        take_over(
            results,
            marks,
            motion,
            warps,
            shapes.centres_uv,
            shapes.limits,
            SEEN_SHARE,
            BITS,
            states,
            lost,
            places,
            out,
        )
        return out, places

"""Following the markers from frame to frame: predicted windows, registration, recovery, flags."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tracker import flags
from tracker.find.finder import MarkerFinder, Sighting
from tracker.predict import Predictor
from tracker.registration import kernel
from tracker.registration.blur import SMALLEST_PX, BlurBank
from tracker.registration.model import Camera, MarkerModel, contrast_state, correlation, reach_px, register
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


@dataclass(frozen=True)
class FrameResult:
    """Positions of m markers in one frame; NaN and NOT_FOUND where a marker is missing.

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


@dataclass
class _Track:
    """What changes about a marker while it is followed."""

    model: MarkerModel
    bank: BlurBank
    warp: FloatArray
    reach: float
    state: FloatArray | None = None
    gain: float = 1.0
    lost: int = 0
    since_refresh: int = REFRESH_EVERY


class Follower:
    """Follows calibrated markers through a recording, one frame after the other.

    Parameters
    ----------
    models : tuple of MarkerModel, length m
    camera : Camera
    finder : MarkerFinder
        Asked again for what was lost.
    exposure_share : float
        Exposure time over the time between frames; 0 when it is not known.
    """

    def __init__(
        self, models: tuple[MarkerModel, ...], camera: Camera, finder: MarkerFinder, exposure_share: float
    ) -> None:
        self._camera = camera
        self._finder = finder
        self._exposure_share = exposure_share
        self._tracks = [_Track(m, BlurBank(m.template), m.warp, reach_px(m.template, m.warp)) for m in models]
        self._predictor = Predictor(len(models))
        for k, model in enumerate(models):
            self._predictor.start(k, np.array([model.sighting.x_px, model.sighting.y_px]))

    def missing(self, flag: int) -> FrameResult:
        """The row of a frame without picture; the windows move on."""
        m = len(self._tracks)
        self._predictor.update(np.full((m, 2), np.nan))
        nothing = np.full(m, np.nan)
        return FrameResult(
            nothing, nothing, nothing, nothing, np.full(m, flag | flags.NOT_FOUND.value, dtype=np.uint32)
        )

    def step(self, image: GrayImage) -> FrameResult:
        """Positions of all markers in the next frame."""
        aims = self._predictor.positions_px()
        motion = self._predictor.velocity_px() * self._exposure_share
        results = [self._register(image, track, aims[k], motion[k]) for k, track in enumerate(self._tracks)]
        marks = [0] * len(results)
        for k, track in enumerate(self._tracks):
            if not self._believed(track, results[k]):
                results[k], marks[k] = self._recover_nearby(image, track, aims[k])
        self._recover_by_detection(image, results, marks)
        self._drop_coinciding(results, aims)
        return self._finish(results, marks, motion)

    def _register(self, image: GrayImage, track: _Track, aim: FloatArray, motion: FloatArray) -> FloatArray:
        if track.state is None:
            sighting = replace(track.model.sighting, x_px=float(aim[0]), y_px=float(aim[1]))
            if track.model.source == "learned":
                start = np.array([aim[0], aim[1], 0.0, 1.0, 0.0])
            else:
                start = contrast_state(image, sighting)
        else:
            start = track.state.copy()
            start[:2] = aim
        template = track.model.template
        if np.hypot(motion[0], motion[1]) >= SMALLEST_PX:
            template = track.bank.get(track.warp @ motion)
        return register(
            image,
            start,
            track.warp,
            template,
            self._camera,
            reach=track.reach,
            with_angle=track.model.with_angle,
            max_shift_px=4.0 + 0.2 * track.model.sighting.size_px,
        )

    def _believed(self, track: _Track, result: FloatArray, least: float = LEAST_CORRELATION) -> bool:
        if result[kernel.CONVERGED] == 0.0 or result[kernel.SEEN] < LEAST_SEEN_SHARE:
            return False
        usual = max(1.0, track.model.chi2) if np.isfinite(track.model.chi2) else 1.0
        if track.state is not None and result[kernel.GAIN] * track.gain <= 0.0:
            return False
        # An even surface is explained perfectly by a template without contrast: that is no marker.
        if result[kernel.SIGNAL] * result[kernel.PIXELS] < LEAST_SIGNAL:
            return False
        if track.state is not None and not 0.3 < result[kernel.GAIN] / track.gain < 3.0:
            return False
        # With little contrast the correlation is low however good the fit is: then the noise decides.
        good_residual = result[kernel.CHI2] < GOOD_CHI2 * usual
        return bool(correlation(result) >= least or (good_residual and least <= LEAST_CORRELATION))

    def _recover_nearby(self, image: GrayImage, track: _Track, aim: FloatArray) -> tuple[FloatArray, int]:
        """Search a window that grows with the time since the loss; a failed result when nothing fits."""
        nothing = np.full(kernel.RESULT, np.nan)
        nothing[kernel.CONVERGED] = 0.0
        wider = 8.0 + 0.5 * track.model.sighting.size_px + 4.0 * min(track.lost, 15)
        for centre in (aim, None if track.state is None else track.state[:2]):
            if centre is None or not np.all(np.isfinite(centre)):
                continue
            place = coarse_search(image, centre, wider, track.model.template, track.warp, track.gain)
            if place is None:
                continue
            result = self._register(image, track, place, np.zeros(2))
            if self._believed(track, result, LEAST_CORRELATION_AFTER_SEARCH):
                return result, flags.RECOVERED.value
        return nothing, 0

    def _recover_by_detection(self, image: GrayImage, results: list[FloatArray], marks: list[int]) -> None:
        """Ask the finder for markers that are lost, and for the shape of those that fit badly."""
        wanted = []
        for k, track in enumerate(self._tracks):
            lost = results[k][kernel.CONVERGED] == 0.0
            track.since_refresh += 1
            ugly = (
                track.model.sighting.kind == "aruco"
                and correlation(results[k]) < REFRESH_CORRELATION
                and results[k][kernel.CHI2] > GOOD_CHI2 * max(1.0, track.model.chi2)
                and track.since_refresh >= REFRESH_EVERY
            )
            if (lost and (track.lost < PATIENCE or track.lost % IMPATIENT_EVERY == 0)) or ugly:
                wanted.append(k)
        if not wanted:
            return
        by_name = {self._tracks[k].model.sighting.name: k for k in wanted}
        for sighting in self._finder.again(image, tuple(self._last_seen(k) for k in wanted)):
            k = by_name[sighting.name]
            results[k], marks[k] = self._reshape(image, self._tracks[k], sighting, results[k], marks[k])
        for k in wanted:
            self._tracks[k].since_refresh = 0

    def _last_seen(self, k: int) -> Sighting:
        track = self._tracks[k]
        if track.state is None:
            return track.model.sighting
        return replace(track.model.sighting, x_px=float(track.state[0]), y_px=float(track.state[1]))

    def _reshape(
        self, image: GrayImage, track: _Track, sighting: Sighting, before: FloatArray, mark: int
    ) -> tuple[FloatArray, int]:
        """Register with the shape of a detection; its corners alone when no fit confirms them."""
        was_lost = before[kernel.CONVERGED] == 0.0
        warp = track.model.refine @ sighting.warp if sighting.kind == "aruco" else track.warp
        candidate = replace_track(track, warp)
        if candidate.state is not None:
            candidate.state = candidate.state.copy()
            candidate.state[2] = 0.0 if sighting.kind == "aruco" else candidate.state[2]
        place = np.array([sighting.x_px, sighting.y_px])
        result = self._register(image, candidate, place, np.zeros(2))
        if self._believed(candidate, result) and (was_lost or correlation(result) > correlation(before)):
            track.warp, track.reach = candidate.warp, candidate.reach
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
        track.warp, track.reach = candidate.warp, candidate.reach
        track.state = None
        return corners_only, mark | flags.RECOVERED.value | flags.POOR_FIT.value

    def _drop_coinciding(self, results: list[FloatArray], aims: FloatArray) -> None:
        """Two markers in one place: the one that jumped farther is the wrong one."""
        places = np.array([r[:2] for r in results])
        for k in range(len(results)):
            for other in range(k):
                near = 0.4 * self._tracks[k].model.sighting.size_px
                if np.hypot(*(places[k] - places[other])) < near:
                    jumps = np.linalg.norm(places[[k, other]] - aims[[k, other]], axis=1)
                    loser = k if jumps[0] >= jumps[1] else other
                    results[loser][:] = np.nan
                    results[loser][kernel.CONVERGED] = 0.0
                    places[loser] = np.nan

    def _finish(self, results: list[FloatArray], marks: list[int], motion: FloatArray) -> FrameResult:
        m = len(results)
        out = np.full((4, m), np.nan)
        bits = np.array(marks, dtype=np.uint32)
        seen = np.full((m, 2), np.nan)
        for k, (track, result) in enumerate(zip(self._tracks, results, strict=True)):
            if result[kernel.CONVERGED] == 0.0:
                track.lost += 1
                bits[k] = flags.NOT_FOUND.value
                continue
            seen[k] = result[:2]
            track.lost = 0
            enlarged = np.sqrt(max(1.0, result[kernel.CHI2]))
            centre = result[:2] + _centre_shift(track, result[kernel.ANGLE])
            out[:, k] = (*centre, result[kernel.SD_X] * enlarged, result[kernel.SD_Y] * enlarged)
            bits[k] |= self._flags(track, result, motion[k])
            if np.isfinite(result[kernel.GAIN]):
                track.state = result[:5].copy()
                track.gain = float(result[kernel.GAIN])
        self._predictor.update(seen)
        return FrameResult(out[0], out[1], out[2], out[3], bits)

    def _flags(self, track: _Track, result: FloatArray, motion: FloatArray) -> int:
        value = 0
        if result[kernel.SEEN] < SEEN_SHARE:
            value |= flags.EDGE.value
        if result[kernel.SATURATED] > 0.01 * result[kernel.PIXELS]:
            value |= flags.SATURATED.value
        if np.hypot(motion[0], motion[1]) > 1.0:
            value |= flags.BLURRED.value
        usual = max(1.0, track.model.chi2) if np.isfinite(track.model.chi2) else 1.0
        # Six standard deviations of a chi-square per degree of freedom, and half as much again as is usual.
        limit = max(1.0 + 6.0 * np.sqrt(2.0 / max(result[kernel.PIXELS], 1.0)), 1.5 * usual, 1.5)
        if result[kernel.CHI2] > limit:
            value |= flags.POOR_FIT.value
        return value


def replace_track(track: _Track, warp: FloatArray) -> _Track:
    """A copy of a track with another warp."""
    return replace(track, warp=warp, reach=reach_px(track.model.template, warp))


def _centre_shift(track: _Track, angle_rad: float) -> FloatArray:
    """From the template's zero to the marker's centre, in px of the picture."""
    if not np.any(track.model.centre_uv):
        return np.zeros(2)
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    turned = np.array([[cosine, -sine], [sine, cosine]]) @ track.model.centre_uv
    return np.asarray(np.linalg.inv(track.warp) @ turned)

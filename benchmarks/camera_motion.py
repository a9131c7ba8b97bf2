"""Cameras that drift along the beam or zoom: ``python -m benchmarks.camera_motion [--seeds N] [--films]``.

Tracks of markers on a vibrating beam are made with the camera's motion along the beam and changes of the scale, and
identified. The table counts answers that are right (frequency and damping within `LIMIT_SD` sd), wide (right, with an
interval of damping over `WIDE` times that of the same track without motion of the camera), flagged (wrong, or no mode,
with the reason) or silent (wrong without a word, or called corrected). ``--films`` renders films of some cases instead.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.line_scenes import mode_shape
from modal_id import IdentifiedMode, IdentifySettings, identify
from sim.render import (
    ArucoMarker,
    Camera,
    DotMarker,
    Marker,
    SampledMotion,
    Scene,
    render_frames,
    write_video,
)
from tracker import DecodeReport, MarkerTracks, TimeAxis, TrackerSettings, displacement_series, track

Array = NDArray[np.float64]
# With right intervals, 0.5 % of the answers have a frequency or a damping ratio beyond this many sd.
LIMIT_SD = 3.0
WIDE = 1.5
LENGTH_PX = 400.0
OUTCOMES = ("right", "wide", "flagged", "silent")
# Rendered frames with markers of the same size: a zoom of 3 % in 1000 frames changes dots by 0.006 px in between.
_SAME_SIZE = 20


@dataclass(frozen=True)
class CameraCase:
    """A decay of the tip along x, with markers along y, seen by a camera that moves.

    Attributes
    ----------
    drift_px, drift_hz : float
        Motion along the beam: linear over the record where the frequency is 0, otherwise the amplitude of a sine.
    zoom, zoom_hz : float
        The same for the change of the scale.
    oblique_rad : float
        Angle of the drift from the beam.
    markers : int
        Evenly along the beam up to its tip.
    """

    drift_px: float = 0.0
    drift_hz: float = 0.0
    zoom: float = 0.0
    zoom_hz: float = 0.0
    oblique_rad: float = 0.0
    markers: int = 3
    frames: int = 1000
    fps: float = 250.0
    frequency_hz: float = 10.577
    damping_ratio: float = 0.005
    amplitude_px: float = 2.9
    noise_px: float = 0.02
    mode: int = 1
    seed: int = 1

    @property
    def time_s(self) -> Array:
        """Times of the frames, from 0."""
        return np.arange(self.frames) / self.fps

    def xy_px(self) -> Array:
        """Positions without noise, (2, n, m), y downwards from the clamp; foreshortening of the beam included."""
        rng = np.random.default_rng((self.seed, 1))
        omega = 2.0 * np.pi * self.frequency_hz
        pole = omega * complex(-self.damping_ratio, np.sqrt(1.0 - self.damping_ratio**2))
        tip = self.amplitude_px * np.exp(pole * self.time_s + 2j * np.pi * rng.uniform()).real
        fine = np.linspace(0.0, 1.0, 801)
        shape = mode_shape(self.mode, fine)
        slope = np.gradient(shape, fine) / LENGTH_PX
        shortened = np.concatenate([[0.0], np.cumsum(0.5 * slope[1:] ** 2)]) * LENGTH_PX * (fine[1] - fine[0])
        at = np.linspace(1.0 / self.markers, 1.0, self.markers)
        x = tip[:, None] * np.interp(at, fine, shape)
        y = LENGTH_PX * at - tip[:, None] ** 2 * np.interp(at, fine, shortened)
        drift = self.drift_px * self._course(self.drift_hz, rng)[:, None]
        scale = self._scale(rng)[:, None]
        # The centre of the image is that of the beam, 5 px beside it.
        x = scale * (x + 5.0) + np.sin(self.oblique_rad) * drift
        y = scale * (y - 0.5 * LENGTH_PX) + np.cos(self.oblique_rad) * drift
        return np.stack([x, y])

    def _scale(self, rng: np.random.Generator) -> Array:
        return 1.0 + self.zoom * self._course(self.zoom_hz, rng)

    def scale(self) -> Array:
        """Scale of the image in each frame."""
        rng = np.random.default_rng((self.seed, 1))
        # That of the vibration's phase is drawn before.
        rng.uniform()
        if self.drift_hz:
            rng.uniform()
        return self._scale(rng)

    def _course(self, frequency_hz: float, rng: np.random.Generator) -> Array:
        if frequency_hz == 0.0:
            return self.time_s / self.time_s[-1]
        return np.sin(2.0 * np.pi * (frequency_hz * self.time_s + rng.uniform()))

    def tracks(self) -> MarkerTracks:
        """Positions with white noise, as tracked."""
        noise = np.random.default_rng((self.seed, 2)).standard_normal((2, self.frames, self.markers))
        xy = self.xy_px() + np.array([100.0, 300.0])[:, None, None] + self.noise_px * noise
        sd = np.full(xy[0].shape, self.noise_px)
        return MarkerTracks(
            recording="case",
            markers=tuple(f"m{k + 1}" for k in range(self.markers)),
            frame=np.arange(self.frames),
            time_s=self.time_s,
            x_px=xy[0],
            y_px=xy[1],
            sd_x_px=sd,
            sd_y_px=sd.copy(),
            flags=np.zeros(sd.shape, np.uint32),
            positions_mm=np.full(self.markers, np.nan),
            scale=None,
            time_axis=TimeAxis("user", Fraction(self.fps)),
            decode=DecodeReport("ffv1", "gray", 200, 600, 8, self.frames, self.frames, 0, lossy=False),
        )

    def still(self) -> CameraCase:
        """The same track filmed by a camera at rest."""
        return replace(self, drift_px=0.0, zoom=0.0)


@dataclass(frozen=True)
class Answer:
    """Errors of one case in sd, NaN without a mode, the sd of damping, and what the user is told."""

    frequency_z: float
    damping_z: float
    damping_sd: float
    told: tuple[str, ...]


def answer(case: CameraCase, tracks: MarkerTracks) -> Answer:
    """Identify the tracks of a case, with nothing known of its beam."""
    series = displacement_series(tracks, unit="px")
    found = identify(series, IdentifySettings(onset_s=0.0, seed=case.seed))
    camera = [note for note in series.notes if "camera" in note and "corrected" not in note]
    mode = getattr(found, "target", None)
    if mode is None and getattr(found, "modes", ()):
        mode = max(found.modes, key=lambda m: m.amplitude)
    if not isinstance(mode, IdentifiedMode):
        return Answer(np.nan, np.nan, np.nan, ("no mode", *camera))
    return Answer(
        (mode.frequency_hz - case.frequency_hz) / mode.frequency_sd_hz,
        (mode.damping_ratio - case.damping_ratio) / mode.damping_ratio_sd,
        mode.damping_ratio_sd,
        (*mode.wrong_flags, *camera),
    )


@cache
def _still_sd(case: CameraCase) -> float:
    return answer(case, case.tracks()).damping_sd


def outcome(case: CameraCase, found: Answer) -> str:
    """One of `OUTCOMES`."""
    if max(abs(found.frequency_z), abs(found.damping_z)) < LIMIT_SD:
        return "wide" if found.damping_sd > WIDE * _still_sd(case.still()) else "right"
    return "flagged" if found.told else "silent"


def film(case: CameraCase, folder: Path, kind: str = "blob") -> MarkerTracks:
    """Render a case as dots of 10 px or codes of 36 px, whose size changes with the scale, and track it.

    Raises
    ------
    RuntimeError
        If no marker is tracked, with the reason.
    """
    x, y = case.xy_px()
    width, height = 160, round(LENGTH_PX) + 80
    camera = Camera(
        width_px=width,
        height_px=height,
        mm_per_px=1.0,
        origin_px=(0.5 * width, 0.5 * height),
        read_noise_sd=1.5,
        noise_gain=0.04,
    )
    # y points up in a scene.
    motion = SampledMotion(case.time_s, x, -y, np.zeros_like(x))
    rng, scale = np.random.default_rng((case.seed, 3)), case.scale()

    def frames() -> Iterator[NDArray[Any]]:
        for first in range(0, case.frames, _SAME_SIZE):
            rows = slice(first, first + _SAME_SIZE)
            markers = tuple(_marker(kind, k, float(np.mean(scale[rows]))) for k in range(case.markers))
            yield from render_frames(Scene(markers=markers, motion=motion), camera, case.time_s[rows], rng)

    path = folder / "film.mkv"
    write_video(path, frames(), fps_container=Fraction(25), codec="ffv1")
    tracks = track(path, TrackerSettings(fps=Fraction(case.fps), kind=kind), recording="film")
    if not isinstance(tracks, MarkerTracks):
        raise RuntimeError(tracks.reason)  # noqa: TRY004 - a result, not a type, is wrong
    return tracks


def _marker(kind: str, index: int, scale: float) -> Marker:
    if kind == "blob":
        return DotMarker(diameter_mm=10.0 * scale)
    return ArucoMarker(
        dictionary="DICT_4X4_50", marker_id=index, size_mm=36.0 * scale, quiet_zone_mm=8.0 * scale
    )


def cases() -> Iterator[tuple[str, CameraCase]]:
    """Names of the groups of the table, and a case of each."""
    for markers in (1, 3):
        some = CameraCase(markers=markers)
        for px in (1.0, 2.0, 4.0, 8.0):
            yield f"drift, {markers} markers", replace(some, drift_px=px)
            yield f"drift, {markers} markers", replace(some, drift_px=px, oblique_rad=0.5)
            for hz in (0.1, 0.3, 0.5):
                yield f"drift, {markers} markers", replace(some, drift_px=px, drift_hz=hz)
    for markers in (1, 2, 3, 6):
        for zoom in (0.01, 0.02, 0.03):
            for hz in (0.0, 0.1, 0.3):
                one = CameraCase(zoom=zoom, zoom_hz=hz, markers=markers)
                yield f"zoom, {markers} markers", one
        yield f"at rest, {markers} markers", CameraCase(markers=markers)
        yield f"at rest, {markers} markers", CameraCase(markers=markers, amplitude_px=60.0)
    yield "long film", CameraCase(drift_px=8.0, drift_hz=0.5, frames=5000)
    yield "long film", CameraCase(zoom=0.02, drift_px=4.0, frames=5000)
    yield "few cycles", CameraCase(drift_px=8.0, frequency_hz=3.19, frames=650)


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="tracks of each case")
    parser.add_argument(
        "--films", action="store_true", help="rendered films of some cases in place of tracks"
    )
    options = parser.parse_args(arguments)
    counts: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for group, one, kind in _films() if options.films else ((*pair, "") for pair in cases()):
            for seed in range(1, 1 + (1 if options.films else options.seeds)):
                case = replace(one, seed=seed)
                found = answer(case, film(case, Path(folder), kind) if kind else case.tracks())
                result = outcome(case, found)
                counts.setdefault(group, Counter())[result] += 1
                if result in ("flagged", "silent"):
                    sys.stderr.write(f"{result}: {case}\n    {found}\n")
    sys.stdout.write(f"| camera | {' | '.join(OUTCOMES)} |\n| --- |{' --: |' * len(OUTCOMES)}\n")
    for group, count in counts.items():
        sys.stdout.write(f"| {group} | {' | '.join(str(count[name]) for name in OUTCOMES)} |\n")


def _films() -> Iterator[tuple[str, CameraCase, str]]:
    for kind, name in (("blob", "dots"), ("aruco", "codes")):
        for amplitude in (2.9, 20.0):
            one = CameraCase(amplitude_px=amplitude)
            yield f"at rest, {name}", one, kind
            for hz in (0.0, 0.3):
                yield f"drift, {name}", replace(one, drift_px=8.0, drift_hz=hz), kind
                yield f"zoom, {name}", replace(one, zoom=0.02, zoom_hz=hz), kind
        yield f"zoom, 2 {name}", CameraCase(zoom=0.01, markers=2), kind
    yield "drift, 1 dot", CameraCase(drift_px=8.0, markers=1), "blob"
    yield "zoom, 1 dot", CameraCase(zoom=0.02, markers=1), "blob"


if __name__ == "__main__":
    main()

"""The paper's five modes of a bare strip, each in films of its own: ``python -m benchmarks.line_modes [--films 8]``.

Drawn films (`benchmarks.line_scenes`) in which material points move exactly as Eq. 1 are tracked and identified like
recordings; the table is that of docs/studies/lines.md.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.line_scenes import CODECS, Array, LineScene, mode_shape
from modal_id import IdentifiedMode, IdentifySettings, identify
from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ
from sim.render import write_video
from tracker import FailedTracking, MarkerTracks, TrackerSettings, displacement_series, track

LENGTH_MM, LENGTH_PX, FRAMES = 500.0, 220.0, 400
# Typical amplitude of the tip of each mode; that of the large rotation is 200 mm of 500 mm.
TIP_PX = (8.0, 6.0, 5.0, 4.0, 4.0)
LARGE_TIP_PX = 0.4 * LENGTH_PX
CYCLES_PER_FRAME, LARGE_CYCLES_PER_FRAME = 0.0913, 0.05


@dataclass(frozen=True)
class ModeFilm:
    """One film; width, slant, place within the pixel, amplitude, phase and noise follow from the seed."""

    mode: int
    seed: int
    frames: int = FRAMES
    large: bool = False
    codec: str = "lossless"

    @property
    def frequency_hz(self) -> float:
        """Natural frequency."""
        return MEASURED_FREQUENCY_HZ[self.mode - 1]

    @property
    def damping_ratio(self) -> float:
        """Damping ratio."""
        return MEASURED_DAMPING_RATIO[self.mode - 1]

    @property
    def fps(self) -> float:
        """Frames per second, with one decimal."""
        return round(self.frequency_hz / (LARGE_CYCLES_PER_FRAME if self.large else CYCLES_PER_FRAME), 1)

    def scene(self) -> LineScene:
        """What is filmed."""
        rng = np.random.default_rng((self.seed, self.mode, int(self.large)))
        cycles, zeta = self.frequency_hz / self.fps, self.damping_ratio
        tip = LARGE_TIP_PX if self.large else TIP_PX[self.mode - 1] * rng.uniform(0.7, 1.3)
        across = 220 if self.large else 76
        return LineScene(
            width_px=rng.uniform(2.0, 5.0),
            length_px=LENGTH_PX,
            clamp_px=(0.5 * across + rng.uniform(-0.5, 0.5), 16.6),
            angle_rad=0.5 * np.pi + rng.uniform(-0.03, 0.03),
            modes=(self.mode,),
            tip_px=(tip,),
            cycles_per_frame=(cycles * np.sqrt(1.0 - zeta**2),),
            phase_rad=rng.uniform(0.0, 2.0 * np.pi),
            decay=2.0 * np.pi * cycles * zeta,
            shape=(260, across),
            seed=self.seed,
        )


@dataclass(frozen=True)
class Trial:
    """What was found in one film, in units of the truth or of the stated sd; NaN where no mode was found.

    ``across_px`` and ``along_px`` are the rms and the largest error of the material points.
    """

    group: str
    frequency_off: float = np.nan
    frequency_z: float = np.nan
    frequency_inside: float = np.nan
    damping_off: float = np.nan
    damping_sd: float = np.nan
    damping_z: float = np.nan
    damping_inside: float = np.nan
    mac_lacks: float = np.nan
    rms_px: float = np.nan
    largest_px: float = np.nan


def tracked(film: ModeFilm, folder: Path) -> MarkerTracks:
    """Draw, store and track one film; ValueError where it could not be tracked."""
    scene = film.scene()
    encoder, suffix, options = CODECS[film.codec]
    path = folder / f"film.{suffix}"
    write_video(path, iter(scene.frames(film.frames)), fps_container=Fraction(50), codec=encoder, **options)
    ends = scene.points(0.0, np.array([0.0, scene.length_px]))[0]
    settings = TrackerSettings(
        fps=film.fps, kind="line", line_px=ends.round().tolist(), positions_mm=(0.0, LENGTH_MM)
    )
    tracks = track(path, settings)
    if isinstance(tracks, FailedTracking):
        raise ValueError(tracks.reason)  # noqa: TRY004 - not of the caller's
    return tracks


def compared(film: ModeFilm, tracks: MarkerTracks) -> Trial:
    """Identify a tracked film and compare with its truth."""
    group = f"{film.mode}, 200 mm" if film.large else str(film.mode)
    arc = _arc_px(film.scene(), tracks)
    off = _distances_px(film.scene(), tracks, arc)
    found = identify(displacement_series(tracks, unit="px"), IdentifySettings(onset_s=0.0, seed=film.seed))
    if not found.modes:
        return Trial(group)
    mode = max(found.modes, key=lambda each: each.amplitude)
    low_hz, high_hz = mode.frequency_interval_hz()
    low, high = mode.damping_interval()
    return Trial(
        group,
        mode.frequency_hz / film.frequency_hz - 1.0,
        (mode.frequency_hz - film.frequency_hz) / mode.frequency_sd_hz,
        float(low_hz <= film.frequency_hz <= high_hz),
        mode.damping_ratio / film.damping_ratio - 1.0,
        mode.damping_ratio_sd / film.damping_ratio,
        (mode.damping_ratio - film.damping_ratio) / mode.damping_ratio_sd,
        float(low <= film.damping_ratio <= high),
        1.0 - _mac(mode, mode_shape(film.mode, arc / LENGTH_PX)),
        float(np.sqrt(np.nanmean(off**2))),
        float(np.nanmax(off)),
    )


def _mac(mode: IdentifiedMode, shape: Array) -> float:
    used = np.isfinite(mode.shape)
    found, true = mode.shape[used], shape[used]
    return float(np.abs(np.vdot(found, true)) ** 2 / (np.vdot(found, found).real * np.vdot(true, true)))


def _arc_px(scene: LineScene, tracks: MarkerTracks) -> Array:
    """Distance of each station from the clamp: a line given to a px does not begin there exactly."""
    s = np.arange(0.0, scene.length_px, 0.02)
    points = scene.points(0.0, s)[0]
    seen = np.stack([tracks.x_px[0], tracks.y_px[0]], axis=1)
    return np.array([s[np.argmin(np.linalg.norm(points - place, axis=1))] for place in seen])


def _distances_px(scene: LineScene, tracks: MarkerTracks, arc_px: Array) -> Array:
    """Distance of each station but the last, which the end of the strip disturbs, from its material point."""
    true = np.stack([scene.points(float(k), arc_px)[0] for k in range(len(tracks.time_s))])
    return np.asarray(np.hypot(tracks.x_px - true[..., 0], tracks.y_px - true[..., 1])[:, :-1])


def table(trials: list[Trial]) -> str:
    """Format one row for each mode, and one for all."""
    data = pd.DataFrame(trials)
    head = (
        "mode | films | frequency, % | z | in 90 % | damping ratio, % | sd, % | z | in 90 % | 1 - MAC | "
        "points: rms, largest error / px"
    )
    rows = [f"| {head} |", "| --- " * len(head.split(" | ")) + "|"]
    for name, part in [*data.groupby("group"), ("all", data)]:
        cells = [
            f"{100.0 * part['frequency_off'].abs().max():.5f}",
            f"{np.sqrt((part['frequency_z'] ** 2).mean()):.2f}",
            f"{part['frequency_inside'].sum():.0f}",
            f"{100.0 * part['damping_off'].abs().max():.3f}",
            f"{100.0 * part['damping_sd'].mean():.3f}",
            f"{np.sqrt((part['damping_z'] ** 2).mean()):.2f}",
            f"{part['damping_inside'].sum():.0f}",
            f"{part['mac_lacks'].max():.1e}",
            f"{np.sqrt((part['rms_px'] ** 2).mean()):.4f}, {part['largest_px'].max():.3f}",
        ]
        rows.append(f"| {name} | {len(part)} | {' | '.join(cells)} |")
    return "\n".join(rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--films", type=int, default=8, help="number of films of each mode")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--modes", type=int, nargs="*", default=[1, 2, 3, 4, 5])
    parser.add_argument(
        "--large", type=int, default=4, help="number of films with a tip that moves by 200 mm"
    )
    parser.add_argument("--codec", choices=list(CODECS), default="lossless", help="how the films are stored")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.films)
    films = [ModeFilm(mode, seed, codec=options.codec) for seed in seeds for mode in options.modes]
    large = range(options.first, options.first + options.large)
    films += [ModeFilm(1, seed, large=True, codec=options.codec) for seed in large]
    trials = []
    with tempfile.TemporaryDirectory() as folder:
        for film in films:
            trials.append(compared(film, tracked(film, Path(folder))))
            sys.stdout.write(f"{trials[-1]}\n")
            sys.stdout.flush()
    sys.stdout.write(table(trials) + "\n")


if __name__ == "__main__":
    main()

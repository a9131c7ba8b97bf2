"""Records whose frame rate was converted: ``python -m benchmarks.converted_rates [--seeds N] [--films]``.

Decays sampled evenly are converted: every n-th frame left out, doubled, or the frames blended from n to n - 1 or n + 1,
and identified with the rate of the camera, which is then wrong. The table counts answers that are right (frequency
within `LIMIT_SD` sd), flagged (wrong or refused, with a flag of severity WRONG or a reason), undetectable (the
likelihood of the true times, with all else known, does not exceed that of even ones, for blends with any variance of
eight successive frames or phases of the motion, by the limit for a false alarm) or silent. ``--films`` converts
rendered films in place of series.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.camera_motion import CameraCase
from modal_id import IdentifySettings, identify
from modal_id.modes import Clock, DecayRecord, Kind, any_variance_cost, least_gain
from sim.render import Camera, DotMarker, SampledMotion, Scene, render_frames, write_video
from tracker import DisplacementSeries, MarkerTracks, TrackerSettings, displacement_series, track

Array = NDArray[np.float64]
LIMIT_SD = 3.0
OUTCOMES = ("right", "flagged", "undetectable", "silent")
WAYS = ("left out", "doubled", "blended down", "blended up", "none")
EVERY = (2, 3, 4, 5, 7, 10, 15, 25, 50, 100)


@dataclass(frozen=True)
class ConvertedCase:
    """A decay of one or two modes, seen at `fps` by 1 to 4 channels, and how a converter changed its frames."""

    way: str
    every: int
    seed: int
    fps: float = 500.0

    @property
    def ratio(self) -> float:
        """Recorded frames for each frame of the file."""
        if self.way == "none":
            return 1.0
        return self.every / (self.every + (-1 if self.way in ("left out", "blended down") else 1))

    def _modes(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Frequencies in Hz and damping ratios, the strongest mode first."""
        first = self.fps * float(np.exp(rng.uniform(np.log(0.01), np.log(0.3))))
        zeta = float(np.exp(rng.uniform(np.log(0.001), np.log(0.01))))
        second = first * float(np.exp(rng.uniform(np.log(1.3), np.log(6.3))))
        if rng.random() < 0.5 or second > 0.45 * self.fps:
            return np.array([first]), np.array([zeta])
        return np.array([first, second]), np.array([zeta, 1.4 * zeta])

    def record(self) -> tuple[DisplacementSeries, DecayRecord, float, float]:
        """The series, what would be known of it with the true modes, the phase of the clock, and the frequency."""
        rng = np.random.default_rng([WAYS.index(self.way), self.every, self.seed])
        hz, zeta = self._modes(rng)
        frames, channels = int(rng.integers(400, 2500)), int(rng.integers(1, 5))
        noise = float(np.exp(rng.uniform(np.log(2e-3), np.log(0.03))))
        poles = 2.0 * np.pi * hz / self.fps * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
        place = self.ratio * np.arange(frames) + rng.uniform()
        recorded = np.arange(int(place[-1]) + 2)
        amplitudes = np.array([1.0, rng.uniform(0.05, 0.5)])[: hz.size] * np.exp(
            2j * np.pi * rng.random(hz.size)
        )
        shapes = rng.uniform(0.3, 1.0, (hz.size, channels))
        motion = (np.exp(np.outer(recorded, poles)) * amplitudes).real
        sampled = motion @ (shapes / shapes.max(axis=1, keepdims=True))
        sampled += noise * rng.standard_normal(sampled.shape)
        frame = np.floor(place + 1e-9).astype(np.intp)
        weight = (place - frame)[:, None] if self.way.startswith("blended") else 0.0
        values = (1.0 - weight) * sampled[frame] + weight * sampled[frame + 1]
        known = DecayRecord(
            np.arange(frames),
            values / noise,
            poles * self.ratio,
            0,
            np.zeros(hz.size, dtype=bool),
            np.full((frames, 1), frames**-0.5),
        )
        phase = float(np.mod(place[frames // 2], 1.0))
        return series_of(values, self.fps), known, phase, float(hz[0])

    def undetectable(self, known: DecayRecord, phase: float) -> bool:
        """Whether the true times explain the record no better than even ones do, all else known.

        Nobody knows whether the noise of a recording is that of a codec or of a marker in motion.
        """
        kind: Kind = "blended" if self.way.startswith("blended") else "moved"
        every = known.all_modes
        even = known.fit(known.evenly(), every)
        cost = any_variance_cost(known, even) if kind == "blended" else even.cost
        true = known.fit(known.waves(Clock(kind, self.ratio, phase))._replace(double=None), every)
        return cost - true.cost < least_gain(known)


def series_of(values: Array, fps: float) -> DisplacementSeries:
    """Channels without names or positions."""
    n, k = values.shape
    names = tuple(f"m{one + 1}" for one in range(k))
    time_s = np.arange(n) / fps
    return DisplacementSeries(
        "case", time_s, names, values, np.full((n, k), np.nan), "px", np.full(k, np.nan)
    )


def answer(series: DisplacementSeries, frequency_hz: float) -> tuple[str, str]:
    """Right, flagged or silent, and what was found."""
    found = identify(series, IdentifySettings(onset_s=0.0))
    if not getattr(found, "modes", ()):
        return "flagged", str(getattr(found, "reason", "driven"))
    mode = max(found.modes, key=lambda one: one.amplitude)
    if mode.wrong_flags:
        return "flagged", " ".join(mode.wrong_flags)
    right = abs(mode.frequency_hz - frequency_hz) < LIMIT_SD * mode.frequency_sd_hz
    return ("right" if right else "silent"), f"{mode.frequency_hz:.6g} Hz for {frequency_hz:.6g} Hz"


def outcome(case: ConvertedCase) -> tuple[str, str]:
    """One of `OUTCOMES`, and what was found."""
    series, known, phase, hz = case.record()
    result, words = answer(series, hz)
    if result == "silent" and case.undetectable(known, phase):
        return "undetectable", words
    return result, words


def cases(seeds: int) -> Iterator[ConvertedCase]:
    """All ways with every step, and as many records that are not converted."""
    for way in WAYS:
        for every in EVERY:
            for seed in range(seeds):
                yield ConvertedCase(way, every, seed)


def films(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Way, outcome and what was found for converted films of a vibrating beam with three dots."""
    case = CameraCase(frames=1200, amplitude_px=6.0)
    x, y = case.xy_px()
    camera = Camera(
        width_px=128,
        height_px=480,
        mm_per_px=1.0,
        origin_px=(64.0, 240.0),
        read_noise_sd=1.5,
        noise_gain=0.04,
    )
    # y points up in a scene.
    motion = SampledMotion(case.time_s, x, -y, np.zeros_like(x))
    scene = Scene(markers=(DotMarker(diameter_mm=10.0),) * case.markers, motion=motion)
    frames = list(render_frames(scene, camera, case.time_s, np.random.default_rng(3)))
    for way, every in (
        ("none", 1),
        *((way, n) for way in WAYS[:4] for n in (4, 5, 10, 100)),
        ("repeated", 3),
    ):
        if way == "repeated":
            chosen = [image for image in frames[:600] for _ in range(every)]
        else:
            ratio = ConvertedCase(way, every, 0).ratio
            places = np.arange(0.0, len(frames) - 2, ratio)
            blended = way.startswith("blended")
            chosen = [_blend(frames, place) if blended else frames[int(place + 1e-9)] for place in places]
        path = folder / "converted.mkv"
        write_video(path, iter(chosen), fps_container=Fraction(25), codec="ffv1")
        tracks = track(path, TrackerSettings(fps=Fraction(case.fps), kind="blob"), recording="film")
        if isinstance(tracks, MarkerTracks):
            yield f"{way} {every}", *answer(displacement_series(tracks, unit="px"), case.frequency_hz)
        else:
            yield f"{way} {every}", "flagged", tracks.reason


def _blend(frames: list[NDArray[np.uint8]], place: float) -> NDArray[np.uint8]:
    first = int(place + 1e-9)
    weight = place - first
    return np.rint((1.0 - weight) * frames[first] + weight * frames[first + 1]).astype(np.uint8)


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="records of each way and step")
    parser.add_argument("--films", action="store_true", help="rendered films in place of series")
    options = parser.parse_args(arguments)
    if options.films:
        with tempfile.TemporaryDirectory() as folder:
            for name, result, words in films(Path(folder)):
                sys.stdout.write(f"{name}: {result} ({words})\n")
        return
    counts: dict[str, Counter[str]] = {way: Counter() for way in WAYS}
    for case in cases(options.seeds):
        result, words = outcome(case)
        counts[case.way][result] += 1
        if result == "silent" or (case.way == "none" and result != "right"):
            sys.stderr.write(f"{result}: {case}: {words}\n")
    sys.stdout.write(f"| conversion | {' | '.join(OUTCOMES)} |\n| --- |{' --: |' * len(OUTCOMES)}\n")
    for way, count in counts.items():
        sys.stdout.write(f"| {way} | {' | '.join(str(count[name]) for name in OUTCOMES)} |\n")


if __name__ == "__main__":
    main()

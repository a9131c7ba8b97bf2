"""What encoders leave out of small motions, and the intervals: ``python -m benchmarks.encoders --films 3``.

The films of `benchmarks.films` in nine settings of x264 and x265. Two Markdown tables: errors of amplitude and phase
over the motion from frame to frame, and the intervals for each setting.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from fractions import Fraction
from functools import partial
from pathlib import Path

import av
import numpy as np
import pandas as pd

from benchmarks.film_scenes import FPS, SIZES_PX, Film
from benchmarks.films import run_film
from modal_id.solve import pole
from modalcam.pipeline import Cache
from tracker import FailedTracking, FloatArray, MarkerTracks, displacement_series, track

ENCODERS: dict[str, tuple[str, dict[str, str]]] = {
    "defaults, 18": ("libx264", {"crf": "18"}),
    "defaults, 23": ("libx264", {"crf": "23"}),
    "defaults, 28": ("libx264", {"crf": "28"}),
    "without mbtree, 18": ("libx264", {"crf": "18", "x264-params": "mbtree=0"}),
    "preset veryslow, 18": ("libx264", {"crf": "18", "preset": "veryslow"}),
    "x265 defaults, 18": ("libx265", {"crf": "18", "x265-params": "log-level=none"}),
    "no B frames, a key frame every 25, 18": (
        "libx264",
        {"crf": "18", "x264-params": "bframes=0:keyint=25"},
    ),
    "tuned for zero latency, 18": ("libx264", {"crf": "18", "tune": "zerolatency"}),
    "preset ultrafast, 18": ("libx264", {"crf": "18", "preset": "ultrafast"}),
}
# Bounds of the largest motion from one frame to the next, px, and frames of two cycles: one error of the amplitude.
STEPS_PX = (0.0, 0.1, 0.3, 0.7, np.inf)
_FRAMES = 42


def tracked(film: Film, encoder: str) -> MarkerTracks | FailedTracking:
    """Render, encode and track one film."""
    codec, options = ENCODERS[encoder]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        with av.open(str(path), "w") as container:
            stream = container.add_stream(codec, rate=Fraction(25), options=options)
            images = film.images()
            first = next(images)
            stream.height, stream.width, stream.pix_fmt = *first.shape, "yuv420p"
            for image in itertools.chain([first], images):
                frame = av.VideoFrame.from_ndarray(image, format="gray")
                container.mux(stream.encode(frame.reformat(format="yuv420p")))
            container.mux(stream.encode(None))
        return track(path, film.settings(), recording="film")


def errors(film: Film, tracks: MarkerTracks) -> Iterator[dict[str, float]]:
    """Errors of the amplitude and out of phase (late is negative) in sd of a position, for each two cycles."""
    series, truth = displacement_series(tracks, unit="px"), film.truth()
    along = np.array([series.direction[0], -series.direction[1]])
    way = along @ (truth.xy_px - truth.rest_px[:, None])
    error = series.values[:, 0] - way
    sd, time_s = float(np.nanmedian(series.sd)), np.arange(film.frames) / FPS
    wave = np.exp(pole(2.0 * np.pi * truth.frequency_hz, truth.damping_ratio) * time_s)
    first = _fit(wave, way)
    wave = wave * complex(first[0], -first[1])
    for begin in range(0, film.frames - _FRAMES + 1, _FRAMES):
        part = slice(begin, begin + _FRAMES)
        seen = np.isfinite(error[part])
        if np.count_nonzero(seen) < _FRAMES // 2:
            continue
        size = float(np.mean(np.abs(wave[part])))
        found = _fit(wave[part][seen] / np.abs(wave[part][seen]), error[part][seen]) / sd
        step = size * 2.0 * np.pi * truth.frequency_hz / FPS
        yield {"step_px": step, "amplitude": found[0], "phase": -found[1]}


def _fit(wave: np.ndarray, values: FloatArray) -> FloatArray:
    """Coefficients of the real and imaginary part of a wave beside a constant."""
    design = np.column_stack([wave.real, wave.imag, np.ones(wave.size)])
    return np.asarray(np.linalg.lstsq(design, values, rcond=None)[0])


def omissions(rows: pd.DataFrame) -> str:
    """Format the Markdown table of errors: mean and standard deviation over two cycles, kinds and films."""
    names = [f"{low:g} to {high:g} px" for low, high in itertools.pairwise(STEPS_PX)]
    lines = [
        "| encoder, CRF | "
        + " | ".join([f"amplitude, {n}" for n in names] + [f"phase, {n}" for n in names])
        + " |",
        "| --- " * (1 + 2 * len(names)) + "|",
    ]
    for encoder in rows["encoder"].unique():
        own = rows[rows["encoder"] == encoder]
        parts = own.groupby(pd.cut(own["step_px"], STEPS_PX), observed=False)
        cells = [
            f"{mean:.2f} ± {sd:.2f}"
            for column in ("amplitude", "phase")
            for mean, sd in zip(parts[column].mean(), parts[column].std(), strict=True)
        ]
        lines.append(f"| {encoder} | {' | '.join(cells)} |")
    return "\n".join(lines)


def intervals(trials: pd.DataFrame) -> str:
    """Format the Markdown table of z of damping and frequency, rms over the films of each amplitude."""
    z = {
        "zeta": (trials["zeta_found"] - trials["zeta"]) / trials["zeta_sd"],
        "f": (trials["frequency_found_hz"] - trials["frequency_hz"]) / trials["frequency_sd_hz"],
    }
    sizes = sorted(trials["amplitude_px"].unique())
    heads = [f"{name} z, {size:g} px" for name in z for size in sizes]
    lines = ["| encoder, CRF | " + " | ".join(heads) + " |", "| --- " * (1 + len(heads)) + "|"]
    for encoder in (*trials["encoder"].unique(), "all"):
        mine = (trials["encoder"] == encoder) | (encoder == "all")
        cells = [
            f"{np.sqrt(np.mean(one[mine & (trials['amplitude_px'] == size)] ** 2)):.2f}"
            for one in z.values()
            for size in sizes
        ]
        lines.append(f"| {encoder} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Run the films and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--films", type=int, default=3, help="number of films of each cell")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--px", nargs="+", type=float, default=[0.3, 1.0, 5.0])
    parser.add_argument("--encoders", nargs="+", default=list(ENCODERS), choices=ENCODERS)
    parser.add_argument("--cache", type=Path, required=True, help="folder that keeps the tracks")
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    rows, trials = [], []
    for seed in range(options.first, options.first + options.films):
        for encoder in options.encoders:
            for film in (Film(kind, "H.264", px, 1500, seed) for px in options.px for kind in SIZES_PX):
                key = hashlib.sha256(f"{encoder} {film}".encode()).hexdigest()
                found = Cache(options.cache).cached(key, partial(tracked, film, encoder))
                trials.append({"encoder": encoder, **asdict(run_film(film, found))})
                if isinstance(found, MarkerTracks):
                    rows.extend({"encoder": encoder, **row} for row in errors(film, found))
    print(omissions(pd.DataFrame(rows)), intervals(pd.DataFrame(trials)), sep="\n\n")


if __name__ == "__main__":
    main()

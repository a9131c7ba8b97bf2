"""Intervals on film: ``python -m benchmarks.films --films 12 --out films.csv``, table with ``--docs docs/studies``.

Each row of the file is one film: rendered without the tracker's templates, encoded, tracked and identified like a
recording. ``--cache`` keeps the tracks, so that a change of the identification needs no new films.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import tempfile
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.coverage_report import BEGIN, END
from benchmarks.film_scenes import CODECS, FPS, SIZES_PX, Film
from modal_id import IdentifySettings, identify
from modal_id.posterior import modal_bound
from modalcam.pipeline import Cache
from tracker import INTERVAL_ENDS, FailedTracking, MarkerTracks, displacement_series, track


@dataclass(frozen=True)
class Trial:
    """One film; found values are NaN where the mode was not identified.

    ``position_error`` and ``position_sd`` are rms error and median stated sd of a position along the motion, px;
    ``bound`` is the Cramer-Rao bound of the damping ratio for white noise of the rms error.
    """

    kind: str
    codec: str
    amplitude_px: float
    frames: int
    seed: int
    frequency_hz: float
    zeta: float
    frequency_found_hz: float
    frequency_sd_hz: float
    zeta_found: float
    zeta_sd: float
    zeta_low: float
    zeta_high: float
    frequency_low_hz: float
    frequency_high_hz: float
    position_error: float
    position_sd: float
    bound: float
    flags: str


def tracked(film: Film) -> MarkerTracks | FailedTracking:
    """Render, encode and track one film."""
    with tempfile.TemporaryDirectory() as folder:
        return track(film.write(Path(folder)), film.settings(), recording="film")


def run_film(film: Film, tracks: MarkerTracks | FailedTracking) -> Trial:
    """Identify one tracked film and compare with its truth."""
    truth, nan = film.truth(), float("nan")
    found = [nan] * 8
    error = sd = bound = nan
    flags = "FAILED"
    if isinstance(tracks, MarkerTracks):
        series = displacement_series(tracks, unit="px")
        target = getattr(identify(series, IdentifySettings(onset_s=0.0, seed=film.seed)), "target", None)
        along = np.array([series.direction[0], -series.direction[1]])
        way = along @ (truth.xy_px - truth.rest_px[:, None])
        errors = series.values[:, 0] - way
        error, sd = float(np.nanstd(errors)), float(np.nanmedian(series.sd))
        bound = modal_bound(
            np.arange(film.frames) / FPS,
            truth.frequency_hz,
            truth.damping_ratio,
            np.array([film.amplitude_px]),
            0.0,
            np.array([error]),
        ).damping_sd
        if target is not None:
            draws = target.posterior
            found = [
                target.frequency_hz,
                target.frequency_sd_hz,
                target.damping_ratio,
                target.damping_ratio_sd,
                *np.quantile(draws.damping_ratio, INTERVAL_ENDS),
                *np.quantile(draws.frequency_hz, INTERVAL_ENDS),
            ]
            flags = " ".join(target.flags)
    numbers = (float(value) for value in (*found, error, sd, bound))
    return Trial(
        film.kind,
        film.codec,
        film.amplitude_px,
        film.frames,
        film.seed,
        truth.frequency_hz,
        truth.damping_ratio,
        *numbers,
        flags,
    )


def row(part: pd.DataFrame) -> str:
    """Format one cell of the study: z is the rms of error over stated sd, then the coverage of the 90 % interval."""
    good = part[part["zeta_sd"].notna()]
    z_zeta = (good["zeta_found"] - good["zeta"]) / good["zeta_sd"]
    z_f = (good["frequency_found_hz"] - good["frequency_hz"]) / good["frequency_sd_hz"]
    hit = (good["zeta_low"] <= good["zeta"]) & (good["zeta"] <= good["zeta_high"])
    hit_f = (good["frequency_low_hz"] <= good["frequency_hz"]) & (
        good["frequency_hz"] <= good["frequency_high_hz"]
    )
    position = np.sqrt(np.mean((good["position_error"] / good["position_sd"]) ** 2))
    return " | ".join(
        [
            str(len(part)),
            f"{position:.2f}",
            f"{np.sqrt(np.mean(z_f**2)):.2f}",
            f"{hit_f.sum()}",
            f"{np.sqrt(np.mean(z_zeta**2)):.2f}",
            f"{hit.sum()}",
            f"{100.0 * np.mean(good['zeta_sd'] / good['zeta']):.2f}",
            f"{np.mean(good['zeta_sd'] / good['bound']):.1f}",
        ]
    )


def table(trials: pd.DataFrame) -> str:
    """Format the Markdown table: one row per cell, then the cells of all markers, then all films of each codec."""
    head = (
        "codec | marker | px | frames | films | position z | f z | f in 90 % | zeta z | zeta in 90 % | "
        "zeta sd, % | zeta sd / bound"
    )
    lines = [f"| {head} |", "| --- " * len(head.split(" | ")) + "|"]
    for codec in CODECS:
        of_codec = trials[trials["codec"] == codec]
        for (kind, size, frames), part in of_codec.groupby(["kind", "amplitude_px", "frames"]):
            lines.append(f"| {codec} | {kind} | {size:g} | {frames} | {row(part)} |")
        for (size, frames), part in of_codec.groupby(["amplitude_px", "frames"]):
            lines.append(f"| {codec} | all | {size:g} | {frames} | {row(part)} |")
        if len(of_codec):
            lines.append(f"| {codec} | all |  |  | {row(of_codec)} |")
    return "\n".join(lines)


def write_table(files: list[Path], docs: Path) -> None:
    """Update the table in ``films.md``."""
    trials = pd.concat([pd.read_csv(path) for path in files], ignore_index=True)
    page = docs / "films.md"
    before, rest = page.read_text(encoding="utf-8").split(BEGIN)
    page.write_text(f"{before}{BEGIN}\n{table(trials)}\n{END}{rest.split(END)[1]}", encoding="utf-8")


def main() -> None:
    """Run the films of the selected cells, or update the table from files of earlier runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", type=Path, help="files of earlier runs, for --docs")
    parser.add_argument("--docs", type=Path, help="folder with films.md: update its table from the files")
    parser.add_argument("--films", type=int, default=12, help="number of films per cell")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--kinds", nargs="+", default=list(SIZES_PX), choices=SIZES_PX)
    parser.add_argument("--codecs", nargs="+", default=list(CODECS), choices=CODECS)
    parser.add_argument("--px", nargs="+", type=float, default=[0.3, 1.0, 5.0, 20.0])
    parser.add_argument("--frames", nargs="+", type=int, default=[1500, 6000])
    parser.add_argument("--cache", type=Path, help="folder that keeps the tracks")
    parser.add_argument("--out", type=Path, help="file to write")
    options = parser.parse_args()
    if options.docs is not None:
        write_table(options.files, options.docs)
        return
    if options.out is None:
        parser.error("give --out FILE for the results, or --docs FOLDER and the files of earlier runs")
    if options.cache is not None:
        options.cache.mkdir(parents=True, exist_ok=True)
    with options.out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(Trial.__dataclass_fields__))
        writer.writeheader()
        for seed in range(options.first, options.first + options.films):
            for film in (
                Film(kind, codec, px, frames, seed)
                for frames in options.frames
                for px in options.px
                for codec in options.codecs
                for kind in options.kinds
            ):
                if options.cache is None:
                    tracks = tracked(film)
                else:
                    key = hashlib.sha256(repr(film).encode()).hexdigest()
                    tracks = Cache(options.cache).cached(key, partial(tracked, film))
                writer.writerow(asdict(run_film(film, tracks)))
                file.flush()


if __name__ == "__main__":
    main()

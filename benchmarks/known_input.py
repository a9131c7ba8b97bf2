"""Records with a measured base motion, simulated: errors, intervals and computing time of the identified modes.

``python -m benchmarks.known_input --records 30 > known_input.jsonl`` prints a JSON line a record, ``--films 10`` a line
a film of a shaken clamp, on which a marker is the input, and ``--lags 30`` a line a record whose input is late by an
unknown time: motions of the base, and forces of another recorder. ``--first 30`` begins with seed 30.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from benchmarks.known_input_scenes import (
    DAMPING_RATIOS,
    FILM_MM_PER_PX,
    FILM_RATE_HZ,
    FORCE_KINDS,
    FORCE_NOISE_N,
    FORCE_RATE_HZ,
    FREQUENCIES_HZ,
    KINDS,
    MODES,
    NOISE_MM,
    PARTICIPATION,
    RATE_HZ,
    film,
    force_record,
    late_base,
    motion,
    record,
)
from modal_id import Identification, IdentifiedMode, IdentifySettings, identify
from modal_id.response import at_other_times
from tracker import DisplacementSeries, KnownInput, MarkerTracks, TrackerSettings, displacement_series, track

#: Correlation of neighbouring noise values, noise of the input, whether its sd is stated.
CONDITIONS = (
    (0.0, 0.0, True),
    (0.8, 0.0, True),
    (0.0, NOISE_MM, True),
    (0.0, 0.0, False),
    (0.0, NOISE_MM, False),
)


def bound(kind: str, seed: int, correlation: float) -> dict[str, tuple[float, float]]:
    """Cramer-Rao bound of frequency and damping ratio of each mode, for an input without noise.

    Free are, as in the fit, for each marker the factors of the base motion, of its second derivative, of a cubic drift,
    of the response of each mode and its quadrature, and of its free decay. Slopes are differences of simulations.
    """

    def whitened(columns: np.ndarray) -> np.ndarray:
        # The innovations of the noise, whose variance is NOISE_MM^2 (1 - correlation^2).
        sd = NOISE_MM * np.sqrt(1.0 - correlation**2)
        return np.asarray(lfilter([1.0, -correlation], [1.0], columns, axis=0)[1:]) / sd

    def simulated(modes: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        return motion(kind, np.random.default_rng([seed, KINDS.index(kind)]), modes)

    base, responses = simulated(MODES)
    time_s = np.arange(base.size) / RATE_HZ
    slopes = []
    for index, value in enumerate(MODES):
        step = 1e-4 * value
        up, down = (
            simulated((*MODES[:index], value + turn * step, *MODES[index + 1 :]))[1][:, index % 2]
            for turn in (1, -1)
        )
        slopes.append((up - down) / (2.0 * step))
    omega = 2.0 * np.pi * FREQUENCIES_HZ
    free = np.exp(np.outer(time_s, omega * (-DAMPING_RATIOS + 1j * np.sqrt(1.0 - DAMPING_RATIOS**2))))
    # Central differences would lose a tenth of the slope at the end of the sweep, and the bound a fifth.
    linear = [base[:, None], CubicSpline(time_s, base)(time_s, 2)[:, None], np.vander(time_s / time_s[-1], 4)]
    # With the base motion, the slope is that of the resonant part: its second column.
    linear += [responses, CubicSpline(time_s, responses + base[:, None])(time_s, 1), free.real, free.imag]
    columns = whitened(np.column_stack(linear))
    basis = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0]
    information = np.zeros((4, 4))
    for of_marker in PARTICIPATION.T:
        own = whitened(np.column_stack(slopes) * np.tile(of_marker, 2))
        own -= basis @ (basis.T @ own)
        information += own.T @ own
    sd = np.sqrt(np.diag(np.linalg.pinv(information, rcond=1e-12, hermitian=True)))
    return {f"{hz:g}": (float(sd[k]), float(sd[2 + k])) for k, hz in enumerate(FREQUENCIES_HZ)}


def measured(
    kind: str, seed: int, correlation: float, input_noise_mm: float, *, stated: bool
) -> dict[str, object]:
    """Errors over standard deviations and over the bound of the modes found in one record, and its computing time."""
    one = record(kind, seed, input_noise_mm=input_noise_mm, correlation=correlation)
    known = KnownInput("base", one.base, "mm", sd=input_noise_mm if stated else float("nan"))
    series = with_input(one.time_s, one.values, known)
    start = time.process_time()
    modes = _modes(series)
    cpu_s = time.process_time() - start
    limits = bound(kind, seed, correlation) if input_noise_mm == 0.0 else {}
    over_bound = {hz: (errors / limits[hz]).tolist() for hz, _, errors in _errors(modes) if limits}
    return {
        "kind": kind,
        "seed": seed,
        "input_noise_mm": input_noise_mm,
        "correlation": correlation,
        "stated": stated,
        **_scores(modes),
        "over_bound": over_bound,
        "cpu_s": cpu_s,
    }


def filmed(kind: str, seed: int) -> dict[str, object]:
    """Errors over standard deviations of the modes found in a film of the clamp and the beam, and computing time."""
    with tempfile.TemporaryDirectory() as folder:
        path = film(kind, seed, Path(folder) / "film.mkv")
        start = time.process_time()
        settings = TrackerSettings(fps=FILM_RATE_HZ, kind="blob", mm_per_px=FILM_MM_PER_PX, input=("m1",))
        tracks = track(path, settings)
    modes = _modes(displacement_series(tracks)) if isinstance(tracks, MarkerTracks) else ()
    return {"film": kind, "seed": seed, **_scores(modes), "cpu_s": time.process_time() - start}


def late(kind: str, seed: int) -> dict[str, object]:
    """As `measured`, of an input up to 30 ms late or early, and the error of the lag over its sd, which is in us."""
    lag_s = np.random.default_rng([seed, 77]).uniform(-0.03, 0.03)
    if kind in FORCE_KINDS:
        force = force_record(kind, seed, lag_s)
        at_frames = at_other_times(force.force_time_s, force.force, force.time_s)
        values = np.asarray(at_frames, dtype=np.float64)
        sd = FORCE_NOISE_N * np.sqrt(RATE_HZ / FORCE_RATE_HZ)
        series = with_input(
            force.time_s, force.values, KnownInput("force", values, "N", is_force=True, sd=sd)
        )
    else:
        one = record(kind, seed)
        series = with_input(
            one.time_s, one.values, KnownInput("base", late_base(kind, seed, lag_s), "mm", sd=0.0)
        )
    start = time.process_time()
    found = identify(series, IdentifySettings(input_lag_ms="auto"))
    lag: tuple[float, ...] = ()
    if isinstance(found, Identification) and found.response is not None:
        sd_s = found.response.input_lag_sd_s
        lag = ((found.response.input_lag_s - lag_s) / sd_s, 1e6 * sd_s)
    modes = found.modes if isinstance(found, Identification) else ()
    cpu_s = time.process_time() - start
    return {
        "late": kind,
        "seed": seed,
        "lag": lag,
        **_scores(modes),
        "failure": "" if found else str(found),
        "cpu_s": cpu_s,
    }


def with_input(time_s: np.ndarray, values: np.ndarray, known: KnownInput) -> DisplacementSeries:
    return DisplacementSeries(
        name=known.name,
        time_s=time_s,
        channels=("y1", "y2", "y3"),
        values=values,
        sd=np.full(values.shape, np.nan),
        unit="mm",
        positions_mm=np.full(3, np.nan),
        known_input=known,
    )


def _modes(series: DisplacementSeries) -> tuple[IdentifiedMode, ...]:
    found = identify(series)
    return found.modes if isinstance(found, Identification) else ()


def _errors(modes: tuple[IdentifiedMode, ...]) -> Iterator[tuple[str, IdentifiedMode, np.ndarray]]:
    """Modes within a tenth of a true frequency, with its name, and their errors of frequency and damping ratio."""
    for hz, zeta in zip(FREQUENCIES_HZ, DAMPING_RATIOS, strict=True):
        for m in (m for m in modes if abs(m.frequency_hz - hz) < 0.1 * hz):
            yield f"{hz:g}", m, np.array([m.frequency_hz - hz, m.damping_ratio - zeta])


def _scores(modes: tuple[IdentifiedMode, ...]) -> dict[str, object]:
    """Number and flags of the modes, and the errors of the true ones over their standard deviations."""
    z = {hz: (errors / [m.frequency_sd_hz, m.damping_ratio_sd]).tolist() for hz, m, errors in _errors(modes)}
    return {"flags": sorted({flag for m in modes for flag in m.flags}), "modes": len(modes), "z": z}


def main() -> None:
    """Print a JSON line for each record."""
    parser = argparse.ArgumentParser(description="Modes from the response to a measured input, simulated.")
    parser.add_argument("--records", type=int, default=30, help="Records of each kind and noise.")
    parser.add_argument("--films", type=int, default=0, help="Films of each kind instead.")
    parser.add_argument(
        "--lags", type=int, default=0, help="Records of each kind with an unknown lag instead."
    )
    parser.add_argument("--first", type=int, default=0, help="First seed.")
    given = parser.parse_args()
    kinds = (*KINDS[:3], *KINDS[4:])
    count = given.films or given.lags or given.records
    seeds = range(given.first, given.first + count)
    found: Iterator[dict[str, object]]
    if given.films:
        # A film of 200 fps does not show the whole broad motion.
        found = (filmed(kind, seed) for kind in KINDS[:3] for seed in seeds)
    elif given.lags:
        found = (late(kind, seed) for kind in (*kinds, *FORCE_KINDS) for seed in seeds)
    else:
        found = (
            measured(kind, seed, *condition[:2], stated=condition[2])
            for condition in CONDITIONS
            for kind in kinds
            for seed in seeds
        )
    for one in found:
        sys.stdout.write(json.dumps(one) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()

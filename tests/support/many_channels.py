"""Decays of a cantilever seen at many stations, with noise that differs from station to station."""

import numpy as np
from scipy.integrate import cumulative_trapezoid

from sim.render import cantilever_slope
from tracker import DisplacementSeries

LENGTH_MM = 500.0
TRUTH = ((4.0, 0.004, 3.0), (25.1, 0.003, 1.5), (70.2, 0.0025, 0.6))


def cantilever_shapes(stations, modes=3):
    """Shapes at places of 0 to 1 along the beam, 1 at the tip; (stations, modes)."""
    fine = np.linspace(0.0, 1.0, 4001)
    slopes = [cantilever_slope(number, fine) for number in range(1, modes + 1)]
    return np.stack(
        [np.interp(stations, fine, cumulative_trapezoid(s, fine, initial=0)) for s in slopes], axis=1
    )


def station_series(stations, seed, *, n=1200, fps=300.0, truth=TRUTH, missing=0.0, outliers=0.0, errors=None):
    """Series, shapes and noise sd of each station; `missing` and `outliers` are shares of the samples."""
    rng = np.random.default_rng([seed, stations, n])
    time_s, at = np.arange(n) / fps, np.linspace(0.02, 1.0, stations)
    shapes = cantilever_shapes(at, len(truth))
    motion = np.stack(
        [
            a * np.exp((-z + 1j * np.sqrt(1 - z * z)) * 2 * np.pi * f * time_s + 1j * rng.uniform(0, 6)).real
            for f, z, a in truth
        ],
        axis=1,
    )
    sd = np.exp(rng.uniform(np.log(0.003), np.log(0.03), stations))
    clean = motion @ shapes.T + rng.uniform(-1.0, 1.0, stations)
    values = clean + sd * rng.standard_normal((n, stations))
    values[rng.random((n, stations)) < missing] = np.nan
    values += np.where(rng.random((n, stations)) < outliers, 5.0 * rng.standard_normal((n, stations)), 0.0)
    names = tuple(f"s{i + 1}" for i in range(stations))
    series = DisplacementSeries(
        "film", time_s, names, values, np.tile(sd, (n, 1)), "mm", LENGTH_MM * at, position_errors=errors
    )
    return series, shapes, clean

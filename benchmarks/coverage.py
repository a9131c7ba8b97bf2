"""Simulation-based calibration of modal_id: ``python -m benchmarks.coverage --seeds 134 --out coverage.csv``.

Each row of the file is one decay: simulated values, identified values, and the rank of the true value in the posterior.
With ``--emcee``, `modal_id.identify` processes each decay like a recording and the ranks are taken among emcee's
draws. Without it, the log density that emcee samples is integrated on a grid, which takes a fifth of the time and has
no Monte Carlo error.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.special import ndtr

from benchmarks.coverage_cases import CASES, make
from modal_id import FailedMode, IdentifySettings, identify
from modal_id.data import prepare
from modal_id.fit import find_modes
from modal_id.posterior import determine_mode
from modal_id.solve import frequency_hz
from tracker import DisplacementSeries

_REACH = 8.0
_POINTS = 129


@dataclass(frozen=True)
class Trial:
    """One decay; ranks are NaN where the mode was not identified."""

    case: str
    mode: int
    seed: int
    frequency_hz: float
    zeta: float
    frequency_found_hz: float
    frequency_sd_hz: float
    zeta_found: float
    zeta_sd: float
    rank_frequency: float
    rank_zeta: float
    noise_factor: float
    flags: str


def run_trial(case: str, mode: int, seed: int, *, sampled: bool) -> Trial:
    """Identify one decay; `mode` counts from 0. Ranks from emcee's draws, or by quadrature of the sampled density."""
    series, frequency, zeta = make(case, mode, seed)
    found = (
        _by_emcee(series, frequency, zeta, mode, seed) if sampled else _by_quadrature(series, frequency, zeta)
    )
    nan = float("nan")
    return Trial(
        case, mode + 1, seed, frequency, zeta, *(found or (nan, nan, nan, nan, nan, nan, nan, "FAILED"))
    )


Found = tuple[float, float, float, float, float, float, float, str]


def _by_emcee(
    series: DisplacementSeries, frequency: float, zeta: float, mode: int, seed: int
) -> Found | None:
    settings = IdentifySettings(target_frequency_hz=frequency, onset_s=0.0, seed=seed, seed_key=(mode,))
    target = getattr(identify(series, settings), "target", None)
    if target is None:
        return None
    draws = target.posterior
    return (
        target.frequency_hz,
        target.frequency_sd_hz,
        target.damping_ratio,
        target.damping_ratio_sd,
        float(np.mean(draws.frequency_hz < frequency)),
        float(np.mean(draws.damping_ratio < zeta)),
        draws.noise_factor,
        " ".join(target.flags),
    )


def _by_quadrature(series: DisplacementSeries, frequency: float, zeta: float) -> Found | None:
    prepared = prepare(series)
    model = None if isinstance(prepared, str) else find_modes(prepared.data, IdentifySettings().max_modes)
    if model is None:
        return None
    ratio = np.abs(np.log(frequency_hz(model.fit.poles) / frequency))
    index = int(np.argmin(ratio))
    mode = determine_mode(model, index)
    if ratio[index] > np.log(1.1) or isinstance(mode, FailedMode):
        return None
    axis = np.linspace(-_REACH, _REACH, _POINTS)
    positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    log_density = mode.density(positions).reshape(axis.size, axis.size)
    mass = np.exp(log_density - np.max(log_density))
    mass /= np.sum(mass)
    to_hz = 1.0 / (2.0 * np.pi)
    grid_hz = to_hz * (mode.density.centre[0] + mode.density.scale[0] * axis)
    grid_zeta = mode.density.centre[1] + mode.density.scale[1] * axis
    of_frequency = _Marginal.of(grid_hz, np.sum(mass, axis=1), mode.systematic[0], frequency)
    of_zeta = _Marginal.of(grid_zeta, np.sum(mass, axis=0), mode.systematic[1], zeta)
    amplitude_dependent = mode.dependence is not None and mode.dependence.significant
    return (
        of_frequency.mean,
        of_frequency.sd,
        of_zeta.mean,
        of_zeta.sd,
        of_frequency.rank,
        of_zeta.rank,
        mode.density.noise.factor,
        "AMPLITUDE_DEPENDENT" if amplitude_dependent else "",
    )


@dataclass(frozen=True)
class _Marginal:
    mean: float
    sd: float
    rank: float

    @classmethod
    def of(cls, values: np.ndarray, mass: np.ndarray, widening: float, truth: float) -> _Marginal:
        """Marginal of a density on an even grid, constant within each cell, convolved with a normal distribution."""
        mean = float(np.sum(mass * values))
        sd = float(np.sqrt(np.sum(mass * (values - mean) ** 2) + widening**2))
        cell = float(values[1] - values[0])
        if widening > cell:
            return cls(mean, sd, float(np.sum(mass * ndtr((truth - values) / widening))))
        return cls(mean, sd, float(np.sum(mass * np.clip((truth - values) / cell + 0.5, 0.0, 1.0))))


def covered(ranks: np.ndarray, level: float) -> int:
    """Count true values within the central interval of this level; an unidentified mode is not covered."""
    return int(np.count_nonzero(np.abs(ranks - 0.5) < 0.5 * level))


def main() -> None:
    """Run the decays of the selected cases and write one row for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=134, help="number of decays per case and mode")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--modes", type=int, nargs="+", default=[1, 3, 5])
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=CASES)
    parser.add_argument("--emcee", action="store_true", help="compute ranks from emcee's draws")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    with options.out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(Trial.__dataclass_fields__))
        writer.writeheader()
        for case in options.cases:
            for seed in range(options.first, options.first + options.seeds):
                for mode in options.modes:
                    writer.writerow(asdict(run_trial(case, mode - 1, seed, sampled=options.emcee)))
                    file.flush()


if __name__ == "__main__":
    main()

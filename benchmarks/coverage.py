"""Simulation-based calibration of identify: ``python -m benchmarks.coverage --seeds 134 --out coverage.csv``.

Every decay goes through `modal_id.identify` as a recording does, emcee included. A line of the file is one decay: what
was put in, what came out, and the rank of the truth among the draws.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.coverage_cases import CASES, make
from modal_id.identify import identify
from modal_id.settings import IdentifySettings


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


def run_trial(case: str, mode: int, seed: int) -> Trial:
    """Identify one decay; `mode` counts from 0."""
    series, frequency, zeta = make(case, mode, seed)
    settings = IdentifySettings(target_frequency_hz=frequency, onset_s=0.0, seed=seed, seed_key=(mode,))
    target = getattr(identify(series, settings), "target", None)
    nan = float("nan")
    if target is None:
        return Trial(case, mode + 1, seed, frequency, zeta, nan, nan, nan, nan, nan, nan, nan, "FAILED")
    draws = target.posterior
    return Trial(
        case,
        mode + 1,
        seed,
        frequency,
        zeta,
        target.frequency_hz,
        target.frequency_sd_hz,
        target.damping_ratio,
        target.damping_ratio_sd,
        float(np.mean(draws.frequency_hz < frequency)),
        float(np.mean(draws.damping_ratio < zeta)),
        draws.noise_factor,
        " ".join(target.flags),
    )


def covered(ranks: np.ndarray, level: float) -> int:
    """How many truths lie within the central interval of this level; an unidentified mode is not covered."""
    return int(np.count_nonzero(np.abs(ranks - 0.5) < 0.5 * level))


def main() -> None:
    """Run the decays of the chosen cases, one line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=134, help="decays of each case and mode")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--modes", type=int, nargs="+", default=[1, 3, 5])
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=CASES)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    with asked.out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(Trial.__dataclass_fields__))
        writer.writeheader()
        for case in asked.cases:
            for seed in range(asked.first, asked.first + asked.seeds):
                for mode in asked.modes:
                    writer.writerow(asdict(run_trial(case, mode - 1, seed)))
                    file.flush()


if __name__ == "__main__":
    main()

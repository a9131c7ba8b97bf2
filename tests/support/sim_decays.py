"""Identified decays of a beam by linear theory."""

import numpy as np

from modal_id import Identification, IdentifiedMode, Onset, Posterior
from tracker import DisplacementSeries


def exponent(frequency_hz, damping_ratio):
    omega = 2.0 * np.pi * frequency_hz
    return omega * complex(-damping_ratio, np.sqrt(1.0 - damping_ratio**2))


def normal_scores(rng):
    """200 normal draws whose median and sd are exactly 0 and 1; shape (2, 100)."""
    scores = rng.standard_normal((2, 100))
    scores -= np.median(scores)
    return scores / np.std(scores)


def identified_mode(frequency_hz, damping_ratio, shape_mm, number, *, target, rng):
    frequency = frequency_hz * (1.0 + 1e-5 * normal_scores(rng))
    ratio = damping_ratio * (1.0 + 5e-3 * normal_scores(rng))
    posterior = Posterior(
        frequency_hz=frequency,
        damping_ratio=ratio,
        r_hat=(1.0, 1.0),
        ess=(200.0, 200.0),
        autocorrelation_steps=1.0,
        acceptance=0.5,
        noise_factor=1.0,
        systematic_frequency_hz=0.0,
        systematic_damping_ratio=0.0,
        laplace_sd=(1e-5 * frequency_hz, 5e-3 * damping_ratio),
        seed=(1,),
    )
    return IdentifiedMode(
        shape=np.asarray(shape_mm, dtype=complex),
        shape_sd=np.full(len(shape_mm), 1e-3),
        amplitude=float(np.max(np.abs(shape_mm))),
        amplitude_unit="mm",
        posterior=posterior,
        number=number,
        target=target,
    )


def identification(
    modes, *, time_s, positions_mm, fit_from_s, unit="mm", direction=(1.0, 0.0), offset_mm=0.0
):
    """`modes` are (frequency_hz, damping_ratio, complex shape in mm, number); the first is the target."""
    rng = np.random.default_rng(7)
    since = time_s - fit_from_s
    values = np.zeros((time_s.size, positions_mm.size))
    for frequency, ratio, shape, _ in modes:
        values += np.real(np.exp(exponent(frequency, ratio) * since)[:, np.newaxis] * shape)
    values[since < 0.0] = 0.0
    baseline = np.full_like(values, offset_mm)
    series = DisplacementSeries(
        name="made",
        time_s=time_s,
        channels=tuple(f"m{i}" for i in range(positions_mm.size)),
        values=values + baseline,
        sd=np.full_like(values, 1e-3),
        unit=unit,
        positions_mm=positions_mm,
        direction=direction,
    )
    fitted = np.where((since >= 0.0)[:, np.newaxis], values + baseline, np.nan)
    used = np.isfinite(fitted)
    return Identification(
        series=series,
        onset=Onset(fit_from_s, 0.0, fit_from_s, "user", 1.0),
        modes=tuple(
            identified_mode(f, z, shape, number, target=i == 0, rng=rng)
            for i, (f, z, shape, number) in enumerate(modes)
        ),
        failed=(),
        fitted=fitted,
        baseline=np.where(used, baseline, np.nan),
        used=used,
        residual_sd=np.full(positions_mm.size, 1e-3),
        channels_used=np.ones(positions_mm.size, dtype=bool),
    )

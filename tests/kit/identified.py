"""Identifications by linear theory, in the program's classes: exact draws of the posterior, motion by Eq. 1."""

from dataclasses import replace

import numpy as np

from kit.series import QUICK, pole_of, series_of
from modal_id import Identification, IdentifiedMode, IdentifySettings, Onset, Posterior, identify


def quick(series, **settings):
    """What `identify` finds with few steps of the sampler."""
    return identify(series, IdentifySettings(sampler=QUICK, **settings))


def in_sd(mode, frequency_hz, zeta):
    """Errors of frequency and damping ratio over their sd, of a mode or of a row of modes.csv."""
    f = (mode.frequency_hz - frequency_hz) / mode.frequency_sd_hz
    return np.array([f, (mode.damping_ratio - zeta) / mode.damping_ratio_sd])


def assert_inside(mode, frequency_hz, zeta):
    """Both 99.9 % intervals hold the truth."""
    intervals = mode.frequency_interval_hz(0.999), mode.damping_interval(0.999)
    for (low, high), truth in zip(intervals, (frequency_hz, zeta), strict=True):
        assert low < truth < high, f"{mode}: {truth} is not within {low} and {high}"


def normal_scores(rng):
    """200 normal draws whose median and sd are exactly 0 and 1; shape (2, 100)."""
    scores = rng.standard_normal((2, 100))
    scores -= np.median(scores)
    return scores / np.std(scores)


def identified_mode(
    frequency_hz, damping_ratio, shape, number, rng, *, scores=normal_scores, sd=(1e-5, 5e-3), **more
):
    """A mode with standard deviations of these shares; `more` are fields of the mode, or of its posterior."""
    f, z = (
        value * (1.0 + share * scores(rng))
        for value, share in zip((frequency_hz, damping_ratio), sd, strict=True)
    )
    drawn = {
        "r_hat": (1.0, 1.0),
        "ess": (200.0, 200.0),
        "autocorrelation_steps": 1.0,
        "acceptance": 0.5,
        "noise_factor": 1.0,
        "laplace_sd": (sd[0] * frequency_hz, sd[1] * damping_ratio),
        "seed": (1,),
    }
    drawn |= {name: more.pop(name) for name in drawn.keys() & more.keys()}
    shape = np.asarray(shape, dtype=complex)
    given = {
        "shape_sd": np.full(shape.size, 1e-3),
        "amplitude": float(np.max(np.abs(shape))),
        "amplitude_unit": "mm",
        "number": number,
        "target": True,
    }
    posterior = Posterior(frequency_hz=f, damping_ratio=np.abs(z), **drawn)
    return IdentifiedMode(shape=shape, posterior=posterior, **(given | more))


def identified(series, modes, fitted, baseline, used, residual_sd, onset, **more):
    """The identification of all channels of a series; `more` are other fields."""
    channels = series.values.shape[1]
    given = {
        "failed": (),
        "residual_sd": np.full(channels, residual_sd),
        "channels_used": np.ones(channels, dtype=bool),
    }
    return Identification(
        series=series, onset=onset, modes=modes, fitted=fitted, baseline=baseline, used=used, **(given | more)
    )


def identification(modes, *, time_s, positions_mm, fit_from_s, unit="mm", direction=(1.0, 0.0), offset_mm=0):
    """`modes` are (frequency_hz, damping_ratio, complex shape in mm, number); the first is the target."""
    rng = np.random.default_rng(7)
    since = time_s - fit_from_s
    values = np.zeros((time_s.size, positions_mm.size))
    for frequency, ratio, shape, _ in modes:
        values += np.real(np.exp(pole_of(frequency, ratio) * since)[:, np.newaxis] * shape)
    values[since < 0.0] = 0.0
    baseline = np.full_like(values, offset_mm)
    series = series_of(
        time_s, values + baseline, unit, 1e-3, positions_mm=positions_mm, name="made", direction=direction
    )
    fitted = np.where((since >= 0.0)[:, np.newaxis], values + baseline, np.nan)
    used = np.isfinite(fitted)
    found = tuple(
        identified_mode(f, z, shape, number, rng, target=i == 0)
        for i, (f, z, shape, number) in enumerate(modes)
    )
    onset = Onset(fit_from_s, 0.0, fit_from_s, "user", 1.0)
    return identified(series, found, fitted, np.where(used, baseline, np.nan), used, 1e-3, onset)


def identification_of(fps):
    """Two modes of three markers, one sample missing."""
    shapes = [np.array([0.1, 0.5 + 0.01j, 1.0]), np.array([0.3, -0.4, 0.2j])]
    made = identification(
        [(10.19, 0.0028, shapes[0], 2), (26.84, 0.0031, shapes[1], 3)],
        time_s=np.arange(400) / fps,
        positions_mm=np.array([10.0, 20.0, 30.0]),
        fit_from_s=0.0,
    )
    values = made.series.values.copy()
    values[7, 2] = np.nan
    return replace(made, series=replace(made.series, values=values))

"""A strongly damped mode beside long ones: found, with intervals that hold the truth, and never invented."""

import numpy as np
import pytest
from kit.identified import in_sd, quick
from kit.series import pole_of, series_of
from scipy.stats import chi2

from modal_id.data import FitData
from modal_id.fit import find_modes
from modal_id.solve import damping_ratio, frequency_hz

FPS, NOISE = 500.0, 0.004
LONG = ((16.8, 3e-4, 0.3), (20.2, 3e-3, 0.28))


def record(frequency_hz, zeta, seed, amplitude=1.0, duration_s=6.0):
    rng = np.random.default_rng([seed, 8])
    t = np.arange(int(duration_s * FPS)) / FPS
    modes = (*LONG, (frequency_hz, zeta, amplitude))
    motion = sum(a * np.exp(pole_of(f, z) * t + 2j * np.pi * rng.random()).real for f, z, a in modes)
    return t, motion + NOISE * rng.standard_normal(t.size)


# Of 16 records three are divided within the first cycles, where they seem to be driven: two modes are found, not three.
LOST = [pytest.mark.slow, pytest.mark.xfail(strict=True, reason="the record begins after the damped mode")]


@pytest.mark.parametrize(
    ("frequency_hz", "zeta", "seeds"),
    [
        (38.2, 0.235, range(1)),
        (10.0, 0.3, range(1)),
        pytest.param(38.2, 0.235, range(1, 8), marks=LOST),
        pytest.param(66.0, 0.18, range(8), marks=LOST),
        pytest.param(10.0, 0.3, range(1, 8), marks=pytest.mark.slow),
        pytest.param(21.5, 0.2, range(8), marks=pytest.mark.slow),
    ],
)
def test_it_is_found_within_its_interval(frequency_hz, zeta, seeds):
    scores = []
    for seed in seeds:
        found = quick(series_of(*record(frequency_hz, zeta, seed)), seed=seed)
        assert found, found.reason
        truth = [(f, z) for f, z, _ in (*LONG, (frequency_hz, zeta, 1.0))]
        assert len(found.modes) == 3, f"seed {seed}: {[m.frequency_hz for m in found.modes]} for {truth}"
        for mode in found.modes:
            f, z = min(
                truth, key=lambda one: abs(one[0] - mode.frequency_hz) + 10 * abs(one[1] - mode.damping_ratio)
            )
            scores += [*in_sd(mode, f, z)]
    limit = chi2.isf(1e-4, len(scores))
    assert np.sum(np.square(scores)) < limit, f"errors in sd {np.round(scores, 1)}: chi2 above its 1e-4 point"


def test_a_decay_faster_than_the_record_by_hundreds_is_fitted():
    """Its rate times the duration is 350: the search once ended where the motion is exp(-300) at the end."""
    t, y = record(38.2, 0.235, 1)
    data = FitData(t, y[:, None], np.ones((t.size, 1)))
    fit = find_modes(data, 6).fit
    assert fit.converged
    assert np.isclose(damping_ratio(fit.poles)[np.argmax(frequency_hz(fit.poles))], 0.235, atol=0.02)


@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(1, 8), marks=pytest.mark.slow)], ids=str)
@pytest.mark.parametrize(
    "kind", ["white", pytest.param("growing damping", marks=pytest.mark.slow), "slow creep", "held first"]
)
def test_none_is_invented(kind, seeds):
    """What a release, creep or an amplitude-dependent mode leave at the beginning is no mode of a cycle or two."""
    for seed in seeds:
        rng = np.random.default_rng([seed, 9])
        t = np.arange(3000) / FPS
        phase = 2.0 * np.pi * rng.random()
        y = sum(a * np.exp(pole_of(f, z) * t + 1j * phase).real for f, z, a in LONG)
        if kind == "growing damping":
            amplitude = 1.0 / (1.0 + 0.8 * t)
            y = amplitude * np.cos(2.0 * np.pi * 16.8 * t + phase)
        if kind == "slow creep":
            y = y + 0.2 * np.exp(-t / 0.7)
        if kind == "held first":
            y = np.where(t < 0.02, y[10], y)
        found = quick(series_of(t, y + NOISE * rng.standard_normal(t.size)))
        strongly = [m.damping_ratio for m in found.modes if m.damping_ratio > 0.02] if found else []
        assert not strongly, f"{kind}, seed {seed}: a mode of damping ratio {strongly}, which no motion has"

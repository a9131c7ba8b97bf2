"""Predictions of the true and of a wrong model for simulated decays identified by modal_id."""

import numpy as np
import pytest
from kit.series import coloured, series_of

from modal_id import IdentifySettings, SamplerSettings, identify
from sim import MEASURED_DAMPING_RATIO, sample_beam
from sim.beam import AncfBeam, beam_modes
from sim.comparison import Candidate, bands, compare_decay, draw_indices
from sim.damping import GenericDamping, RayleighDamping
from sim.dynamics import simulate, state_with_coordinates
from tracker import Failure

POSITIONS_MM = np.array([90.0, 190.0, 290.0, 390.0, 490.0])
GENERIC = GenericDamping(MEASURED_DAMPING_RATIO)
# the noise differs between markers and grows over the record
NOISE = np.array([1.0, 1.3, 0.8, 1.0, 1.6])
TIP_MM = (8.0, 2.0, 0.9, 0.5, 0.3)
SECONDS = (5.0, 2.5, 2.0, 1.5, 1.2)


@pytest.fixture(scope="module")
def modes():
    return beam_modes(AncfBeam(sample_beam()), 8)


def decay(modes, number, *, colour, seed):
    """Decay in one mode with noise of a hundredth of the tip amplitude, as returned by a tracker."""
    rng = np.random.default_rng([seed, number])
    tip = modes.transverse_at(np.array([0.5]))[0, number - 1]
    coordinate, rate = np.zeros(8), np.zeros(8)
    start = 1e-3 * TIP_MM[number - 1] / tip * np.exp(2j * np.pi * rng.random())
    omega = modes.omega_rad_s[number - 1]
    coordinate[number - 1], rate[number - 1] = start.real, (1j * omega * start).real
    step_s = min(5e-4, 0.3 / omega)
    every = max(1, round(0.12 * 2.0 * np.pi / omega / step_s))
    run = simulate(
        modes.beam,
        GENERIC,
        state=state_with_coordinates(modes.beam, modes, coordinate, rate),
        duration_s=SECONDS[number - 1],
        step_s=step_s,
        output_positions_m=1e-3 * POSITIONS_MM,
        output_every=every,
        modes=modes,
    )
    sd = 0.01 * TIP_MM[number - 1] * np.outer(np.linspace(0.8, 1.2, run.time_s.size), NOISE)
    noise = np.stack([coloured(rng, run.time_s.size, colour) for _ in POSITIONS_MM], axis=1)
    # a tracker may report a wrong noise level but correct ratios between samples
    return series_of(
        run.time_s, 1e3 * run.transverse_m + sd * noise, "mm", 0.5 * sd, POSITIONS_MM, direction=(1.0, 0.0)
    )


def compared(modes, number, *, colour=0.0, seed=1):
    settings = IdentifySettings(
        mode=number,
        expected_frequencies_hz=tuple(modes.frequency_hz),
        expected_shapes=modes.transverse_at(1e-3 * POSITIONS_MM),
        onset_s=0.0,
        sampler=SamplerSettings(max_steps=200),
    )
    found = identify(decay(modes, number, colour=colour, seed=seed), settings)
    assert found, getattr(found, "reason", "")
    posterior = found.target.posterior.damping_ratio.ravel()
    draws = posterior[draw_indices(posterior.size, bands.TUNING.draws)]
    rayleigh = RayleighDamping.from_modes(tuple(modes.omega_rad_s[:2]), MEASURED_DAMPING_RATIO[:2])
    candidates = {
        "generic": Candidate(
            measured(number, found.target.damping_ratio), tuple(measured(number, z) for z in draws)
        ),
        "rayleigh": Candidate(rayleigh),
    }
    result = compare_decay(
        sample_beam(), found, candidates, fit=lambda series: Failure("skipped in this test", series.name)
    )
    assert result, getattr(result, "reason", "")
    return result


def measured(number, damping_ratio):
    ratios = list(MEASURED_DAMPING_RATIO)
    ratios[number - 1] = float(damping_ratio)
    return GenericDamping(tuple(ratios))


@pytest.mark.parametrize(
    ("number", "colour"),
    [(3, 0.0)]
    + [
        pytest.param(number, colour, marks=pytest.mark.slow)
        for number in range(1, 6)
        for colour in (0.0, 0.7)
        if (number, colour) != (3, 0.0)
    ],
)
def test_band_of_the_true_model_contains_90_percent_of_the_samples(modes, number, colour):
    result = compared(modes, number, colour=colour)
    generic, rayleigh = result.models
    assert 0.85 <= generic.coverage <= 0.95
    # neither side is favoured
    low, high = generic.predictive_band
    above, below = (result.measured > high)[result.used], (result.measured < low)[result.used]
    assert 0.02 < above.mean() < 0.09
    assert 0.02 < below.mean() < 0.09
    gain = rayleigh.log_density_gain
    if number > 2:
        assert gain.standard_errors > 10.0, "the wrong model must be clearly worse"
        assert rayleigh.crps_gain.standard_errors < -10.0
    else:
        # both models have the measured ratio here; fitting it gains half a nat, more with coloured noise
        assert abs(gain.total) < 3.0 * gain.se + 3.0

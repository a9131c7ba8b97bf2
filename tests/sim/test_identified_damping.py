"""Identification of a simulated decay recovers the prescribed damping ratio."""

import numpy as np
import pytest
from kit.series import series_of

from docs.reference_solutions import small_decay
from modal_id import IdentifySettings, SamplerSettings, identify
from sim import MEASURED_DAMPING_RATIO, paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import GenericDamping


@pytest.mark.parametrize(
    "number", [1, 3, pytest.param(2, marks=pytest.mark.slow), pytest.param(4, marks=pytest.mark.slow), 5]
)
def test_identification_recovers_generic_damping(number):
    beam = AncfBeam(paper_beam())
    modes = beam_modes(beam, 8)
    duration_s = 8.0 if number == 1 else 3.0
    run = small_decay(beam, modes, GenericDamping(MEASURED_DAMPING_RATIO), number, 1e-3, duration_s)
    # noise of 1e-5 of the amplitude: without noise, the posterior would be narrower than double precision
    noise = 1e-7 * np.random.default_rng(number).standard_normal(run.transverse_m.shape)
    series = series_of(run.time_s, 1e3 * run.transverse_m + noise, "mm", positions_mm=np.array([500.0]))
    settings = IdentifySettings(
        mode=number,
        expected_frequencies_hz=tuple(modes.frequency_hz),
        onset_s=0.0,
        sampler=SamplerSettings(max_steps=200),
    )
    found = identify(series, settings)
    assert found, getattr(found, "reason", "")
    assert found.target.number == number
    assert found.target.damping_ratio == pytest.approx(MEASURED_DAMPING_RATIO[number - 1], rel=1e-3)
    assert found.target.frequency_hz == pytest.approx(modes.frequency_hz[number - 1], rel=1e-5)

"""Predicted intervals: scaling laws and limiting effects, softening against simulation, template noise against fits."""

import numpy as np
import pytest

from modal_id.data import bandwidth_hz, baseline_matrix
from modalcam.apps.plan import Plan, advice, frequency_per_amplitude_squared, predict, template_factors
from modalcam.report.style import significant
from sim import paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import NoDamping
from sim.dynamics import released_state, simulate
from tracker import position_errors


def test_the_tolerance_of_the_rate_adds_to_the_frequency_alone(plan_of):
    """100 and 100 000 ppm of 10.6 Hz, in quadrature with the noise."""
    exact, some, much = (
        predict(plan_of(plan={"modes": [2]}, camera=camera))[0]
        for camera in ({}, {"fps_tolerance_ppm": 100.0}, {"fps_tolerance_ppm": 1e5})
    )
    for mode, ppm in ((some, 100.0), (much, 1e5)):
        clock_hz = 1e-6 * ppm * mode.frequency_hz
        assert mode.frequency_sd_hz == pytest.approx(np.hypot(exact.frequency_sd_hz, clock_hz))
        assert mode.damping_sd == exact.damping_sd


def noise_sd(mode):
    """Predicted standard deviation without the template factor."""
    return mode.damping_sd / mode.template_factor


def test_intervals_scale_with_amplitude_and_rate(plan_of):
    (base,) = predict(plan_of(plan={"modes": [2]}))
    (twice,) = predict(plan_of(plan={"modes": [2], "tip_amplitude_mm": [5.0]}))
    assert noise_sd(base) / noise_sd(twice) == pytest.approx(2.0, rel=1e-6)
    (fast,) = predict(plan_of({"fps": 1000}, plan={"modes": [2]}))
    # Twice the samples of the same motion.
    assert noise_sd(base) / noise_sd(fast) == pytest.approx(np.sqrt(2.0), rel=0.01)
    # More samples do not reduce the template noise.
    assert fast.template_factor > base.template_factor > 1.0


def test_limits_and_expected_failures_are_reported(plan_of):
    slow = predict(plan_of({"fps": 50}))
    texts = advice(Plan(plan_of(), slow))
    assert any("Aliased" in w and "20.74 Hz" in w for w in texts if w.startswith("Mode 3: ")), texts
    assert slow[1].seen_hz == pytest.approx(50.0 - slow[1].frequency_hz)
    fast = {"modes": [3], "tip_amplitude_mm": [60.0], "decay_s": 0.5}
    (blurred,) = predict(plan_of({"exposure_s": 0.0019}, plan=fast))
    assert "exposure blur" in [limit.cause for limit in blurred.limits]
    (short,) = predict(plan_of(plan={"modes": [2], "decay_s": 1.0}))
    assert short.limits[0].cause == "length of the record"
    (tiny,) = predict(plan_of(plan={"modes": [3], "tip_amplitude_mm": [0.02]}))
    assert any("light flicker" in w for w in advice(Plan(plan_of(), (tiny,))))
    # Mode 2 of a cantilever has its node at 0.783 of the length.
    (node,) = predict(plan_of(markers={"positions_mm": [391.7]}, plan={"modes": [2]}))
    assert node.limits[0].cause == "markers near nodes of the mode"
    assert node.limits[0].factor > 10.0


def test_a_nonlinear_amplitude_is_reported_with_the_largest_linear_one(plan_of):
    (large,) = predict(plan_of(plan={"modes": [3], "tip_amplitude_mm": [1.5], "decay_s": 2.0}))
    assert large.linear_tip_mm < 1.0
    tip_mm = 0.99 * large.linear_tip_mm
    (small,) = predict(plan_of(plan={"modes": [3], "tip_amplitude_mm": [tip_mm], "decay_s": 2.0}))
    assert small.linear_tip_mm == float("inf")
    texts = [text for text in advice(Plan(plan_of(), (large,))) if "amplitude-dependent" in text]
    assert len(texts) == 1
    assert f"{significant(large.linear_tip_mm, 2)} mm (mode 3)" in texts[0]


def test_a_mode_softens_with_the_square_of_its_amplitude():
    """One-mode theory of an inextensible beam against the frequency of a simulated motion in mode 3."""
    properties, tip_m = paper_beam(), 2e-3
    beam = AncfBeam(properties)
    modes = beam_modes(beam, 8)
    run = simulate(
        beam, NoDamping(), state=released_state(beam, modes, 3, tip_m), duration_s=2.0, step_s=5e-4,
        output_positions_m=np.array([0.5]), modes=modes,
    )  # fmt: skip
    demodulated = run.transverse_m[:, 0] * np.exp(-1j * modes.omega_rad_s[2] * run.time_s)
    # Windows of 20 cycles average out the doubled frequency; the phase slope is the change in frequency.
    window = round(20.0 / modes.frequency_hz[2] / 5e-4)
    slow = np.convolve(demodulated, np.ones(window) / window, mode="valid")
    slope = np.polyfit(run.time_s[: slow.size], np.unwrap(np.angle(slow)), 1)[0]
    found = slope / modes.omega_rad_s[2]
    expected = frequency_per_amplitude_squared(properties, modes)[2] * tip_m**2
    assert expected < -8e-4
    # The neglected stretching of the beam changes the result by 2 to 4 % in modes 2 to 5.
    assert found == pytest.approx(expected, rel=0.05)


def test_the_first_mode_of_a_hanging_beam_hardly_depends_on_its_amplitude():
    modes = beam_modes(AncfBeam(paper_beam()), 2)
    first, second = frequency_per_amplitude_squared(paper_beam(), modes)
    # Hardening by the nonlinear curvature and softening by the axial inertia cancel.
    assert abs(first) < 1e-3 * abs(second)


def test_the_template_factor_matches_fits_with_the_error_among_the_unknowns():
    """The scatter of damping with an error that varies over the pixel: simulated fits against the formula."""
    rng = np.random.default_rng(6)
    frequency, zeta, amplitude, sd = 10.0, 0.004, 0.9, 0.006
    time = np.arange(2000) / 500.0
    pole = 2.0 * np.pi * frequency * complex(-zeta, np.sqrt(1.0 - zeta**2))
    drift = np.linalg.qr(baseline_matrix(time, bandwidth_hz(frequency)))[0]
    found = {False: [], True: []}
    for _ in range(200):
        wave = amplitude * np.exp(pole * time + 1j * rng.uniform(0.0, 2.0 * np.pi))
        noise = sd * rng.standard_normal(time.size)
        turn = 2.0 * np.pi * (wave.real + rng.uniform())
        shapes = [f(h * turn) / h for h in (1, 2) for f in (np.cos, np.sin)]
        error = position_errors.TUNING.lossless_share * sd * np.column_stack(shapes)
        # One Gauss-Newton step from the true values, with the drift projected out.
        columns = np.column_stack([(time * wave).real, (1j * time * wave).real, wave.real, wave.imag])
        for biased, changes in found.items():
            design = np.column_stack([columns, error]) if biased else columns
            design = design - drift @ (drift.T @ design)
            gram = design.T @ design
            # The coefficients of the error are standard normal: a prior as strong as one sample of the noise.
            gram[4:, 4:] += sd**2 * np.eye(design.shape[1] - 4)
            data = noise + biased * error @ rng.standard_normal(error.shape[1])
            changes.append(-np.linalg.solve(gram, design.T @ data)[0] / abs(pole))
    ratio = np.std(found[True]) / np.std(found[False])
    factor = template_factors(time, frequency, zeta, np.array([amplitude]), np.array([sd]))[1]
    assert factor > 1.3, f"a motion of {amplitude} px: the factor is {factor:.2f}"
    # Ratio of two standard deviations from 200 fits with common noise: its sd is at most sqrt(2 / 400); 3 sd.
    assert ratio == pytest.approx(factor, rel=3.0 * np.sqrt(2.0 / 400.0)), f"{ratio:.2f} for {factor:.2f}"


def test_a_motion_of_many_pixels_or_a_hundredth_hides_no_damping():
    """Far above and far below a pixel the error is not in phase with the motion, or proportional to it."""
    time = np.arange(1500) / 500.0
    for amplitude in (0.01, 40.0):
        factor = template_factors(time, 20.0, 0.004, np.array([amplitude]), np.array([0.006]))[1]
        assert factor == pytest.approx(1.0, abs=0.02), f"{amplitude} px: factor {factor:.3f}"


def test_markers_at_rest_have_no_template_error():
    """Such as a single marker at the clamp: its bounds are infinite, and stay so."""
    assert template_factors(np.arange(100) / 500.0, 20.0, 0.004, np.zeros(1), np.full(1, 0.006)) == (1.0, 1.0)

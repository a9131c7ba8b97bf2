"""`modalcam plan`: predictions against rendered and identified recordings, and what is said of limits."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from modal_id.data.baseline import bandwidth_hz, baseline_matrix
from modalcam import cli
from modalcam.config.schema import ExperimentConfig
from modalcam.errors import ConfigError
from modalcam.planning.page import Plan, advice
from modalcam.planning.predict import predict
from modalcam.planning.request import plan_request
from modalcam.planning.softening import frequency_per_amplitude_squared
from modalcam.planning.suggest import better_places, rates
from modalcam.planning.template_error import BIAS_SHARE, template_factors
from modalcam.planning.tried import try_all
from modalcam.report.style.format import significant
from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.damping import NoDamping
from sim.dynamics.excitation import released_state
from sim.dynamics.simulate import simulate
from sim.reference.paper_beam import paper_beam

BEAM = {
    "length_mm": 500.0,
    "width_mm": 5.0,
    "thickness_mm": 0.5,
    "density_kg_m3": 8000.0,
    "elastic_modulus_mpa": 210000.0,
}


def request(camera=None, markers=None, plan=None):
    config = {
        "camera": {"fps": 500, "mm_per_px": 2.0, **(camera or {})},
        "markers": {
            "kind": "blob",
            "size_mm": 20.0,
            "positions_mm": [190.0, 390.0, 480.0],
            **(markers or {}),
        },
        "beam": BEAM,
        "plan": {"modes": [2, 3], **(plan or {})},
    }
    return plan_request(ExperimentConfig.model_validate(config), Path("experiment.toml"))


def by_noise(mode):
    """The part of the predicted standard deviation that the noise of each frame makes."""
    return mode.damping_sd / mode.template_factor


def test_the_laws_of_noise_amplitude_and_rate():
    (base,) = predict(request(plan={"modes": [2]}))
    (twice,) = predict(request(plan={"modes": [2], "tip_amplitude_mm": [5.0]}))
    assert by_noise(base) / by_noise(twice) == pytest.approx(2.0, rel=1e-6)
    (fast,) = predict(request({"fps": 1000}, plan={"modes": [2]}))
    # Twice the samples of the same motion.
    assert by_noise(base) / by_noise(fast) == pytest.approx(np.sqrt(2.0), rel=0.01)
    # What the template adds is another's: more samples do not average it out.
    assert fast.template_factor > base.template_factor > 1.0


def test_the_template_adds_what_its_bias_puts_into_a_least_squares_fit():
    """The variance of damping from a bias over the pixel, by fitting decays that have one, beside the projection."""
    rng = np.random.default_rng(6)
    frequency, zeta, amplitude, sd = 10.0, 0.004, 0.9, 0.006
    time = np.arange(2000) / 500.0
    pole = 2.0 * np.pi * frequency * complex(-zeta, np.sqrt(1.0 - zeta**2))
    found = {False: [], True: []}
    for _ in range(80):
        wave = amplitude * np.exp(pole * time + 1j * rng.uniform(0.0, 2.0 * np.pi))
        noise = sd * rng.standard_normal(time.size)
        a, b = BIAS_SHARE * sd * rng.standard_normal(2)
        bias = a * np.cos(2.0 * np.pi * wave.real) + b * np.sin(2.0 * np.pi * wave.real)
        drift = baseline_matrix(time, bandwidth_hz(frequency))
        # One Gauss-Newton step from the truth.
        columns = np.column_stack([(time * wave).real, (1j * time * wave).real, wave.real, wave.imag, drift])
        for biased, changes in found.items():
            change = np.linalg.lstsq(columns, noise + biased * bias, rcond=None)[0][0]
            changes.append(-change / abs(pole))
    ratio = np.std(found[True]) / np.std(found[False])
    factor = template_factors(time, frequency, zeta, np.array([amplitude]), np.array([sd]))[1]
    assert factor > 1.5
    # Two standard deviations of 80 each, of which the noise is common: at most sqrt(2 / 160), thrice.
    assert ratio == pytest.approx(factor, rel=3.0 * np.sqrt(2.0 / 160.0))


def test_what_limits_is_named_and_what_cannot_work_is_said():
    slow = predict(request({"fps": 50}))
    assert any("Aliased" in w and "20.74 Hz" in w for w in slow[1].warnings), slow[1].warnings
    assert slow[1].seen_hz == pytest.approx(50.0 - slow[1].frequency_hz)
    fast = {"modes": [3], "tip_amplitude_mm": [60.0], "decay_s": 0.5}
    (blurred,) = predict(request({"exposure_s": 0.0019}, plan=fast))
    assert "exposure blur" in [limit.cause for limit in blurred.limits]
    (short,) = predict(request(plan={"modes": [2], "decay_s": 1.0}))
    assert short.limits[0].cause == "length of the record"
    (tiny,) = predict(request(plan={"modes": [3], "tip_amplitude_mm": [0.02]}))
    assert any("lamps" in w for w in tiny.warnings)
    # Mode 2 of a cantilever has its node at 0.783 of the length.
    (node,) = predict(request(markers={"positions_mm": [391.7]}, plan={"modes": [2]}))
    assert node.limits[0].cause == "markers near nodes of the mode"
    assert node.limits[0].factor > 10.0


def test_better_places_are_better_and_printable():
    asked = request(markers={"positions_mm": [20.0, 60.0, 391.0]})
    places = better_places(asked)
    assert places is not None
    assert np.all(np.diff(places.positions_mm) >= 20.0)
    assert min(places.factors) < 0.9
    moved = predict(request(markers={"positions_mm": list(places.positions_mm)}))
    for now, then, factor in zip(predict(asked), moved, places.factors, strict=True):
        assert then.damping_sd / now.damping_sd == pytest.approx(factor, rel=0.02)


def test_rates_keep_modes_apart():
    asked = request()
    frequency = tuple(m.frequency_hz for m in predict(asked))
    for rate in rates(asked, frequency):
        places = sorted([0.0, 0.5 * rate.fps, *rate.seen_hz])
        assert min(np.diff(places)) > 0.1
        assert rate.aliased == (max(frequency) > 0.5 * rate.fps)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": {"fps": None}}, "camera.fps"),
        ({"markers": {"positions_mm": [600.0]}}, "found 600"),
        ({"plan": {"tip_amplitude_mm": [1.0, 2.0, 3.0]}}, "found 3"),
        ({"markers": {"size_mm": None}}, "size_mm"),
    ],
)
def test_what_is_missing_is_named(changes, words):
    with pytest.raises(ConfigError, match=words):
        request(**changes)


def test_the_command_prints_and_writes(tmp_path):
    config = tmp_path / "experiment.toml"
    config.write_text(
        "[camera]\nfps = 500\nmm_per_px = 2.0\n[markers]\nkind = 'blob'\nsize_mm = 20.0\n"
        "positions_mm = [190.0, 390.0]\n[plan]\nmodes = [2]\n[beam]\n"
        + "".join(f"{k} = {v}\n" for k, v in BEAM.items())
    )
    out = tmp_path / "plan.html"
    result = CliRunner().invoke(cli.app, ["plan", str(config), "-o", str(out)])
    assert result.exit_code == 0, result.output
    assert "10.57" in result.output
    assert "<script" not in out.read_text(encoding="utf-8")


def test_a_mode_softens_with_the_square_of_its_amplitude():
    """Theory of one mode of a beam that does not stretch against the frequency of a simulated motion of mode 3."""
    properties, tip_m = paper_beam(), 2e-3
    beam = AncfBeam(properties)
    modes = beam_modes(beam, 8)
    run = simulate(
        beam, NoDamping(), state=released_state(beam, modes, 3, tip_m), duration_s=2.0, step_s=5e-4,
        output_positions_m=np.array([0.5]), modes=modes,
    )  # fmt: skip
    turned = run.transverse_m[:, 0] * np.exp(-1j * modes.omega_rad_s[2] * run.time_s)
    # Whole cycles of the doubled frequency cancel in windows of 20 cycles; the phase's slope is the change.
    window = round(20.0 / modes.frequency_hz[2] / 5e-4)
    slow = np.convolve(turned, np.ones(window) / window, mode="valid")
    slope = np.polyfit(run.time_s[: slow.size], np.unwrap(np.angle(slow)), 1)[0]
    found = slope / modes.omega_rad_s[2]
    expected = frequency_per_amplitude_squared(properties, modes)[2] * tip_m**2
    assert expected < -8e-4
    # The strip's stretch, left out, takes 2 to 4 % in modes 2 to 5.
    assert found == pytest.approx(expected, rel=0.05)


def test_the_first_mode_of_a_hanging_beam_hardly_depends_on_its_amplitude():
    modes = beam_modes(AncfBeam(paper_beam()), 2)
    first, second = frequency_per_amplitude_squared(paper_beam(), modes)
    # Bending stiffens it as much as the inertia of points drawn towards the clamp softens it.
    assert abs(first) < 1e-3 * abs(second)


def test_an_amplitude_that_shows_is_said_and_a_smaller_one_is_named():
    (large,) = predict(request(plan={"modes": [3], "tip_amplitude_mm": [1.5], "decay_s": 2.0}))
    assert large.linear_tip_mm < 1.0
    (small,) = predict(
        request(plan={"modes": [3], "tip_amplitude_mm": [0.99 * large.linear_tip_mm], "decay_s": 2.0})
    )
    assert small.linear_tip_mm == float("inf")
    said = [text for text in advice(Plan(request(), (large,), None, ())) if "depend on the amplitude" in text]
    assert len(said) == 1
    assert f"{significant(large.linear_tip_mm, 2)} mm (mode 3)" in said[0]


# Filmed by a small camera in a few seconds, and each limited by something else: mode 2 by the length of the record,
# mode 3 by blur with an amplitude at which it softens, mode 1 by a few cycles of a slow mode against drift.
SETUPS = {
    "short": (
        {"fps": 200},
        {"positions_mm": [300.0, 480.0]},
        {"modes": [2], "tip_amplitude_mm": [1.5], "damping_ratio": [0.008], "decay_s": 2.0},
    ),
    "blur": (
        {"fps": 200, "mm_per_px": 0.7, "exposure_s": 0.0048},
        {"size_mm": 10.0, "positions_mm": [300.0, 488.0]},
        {"modes": [3], "tip_amplitude_mm": [1.5], "decay_s": 2.0, "read_noise_sd": 4.0},
    ),
    "aruco": (
        {"fps": 30, "mm_per_px": 2.0},
        {"kind": "aruco", "size_mm": 40.0, "positions_mm": [300.0, 460.0]},
        {
            "modes": [1],
            "tip_amplitude_mm": [5.0],
            "damping_ratio": [0.01],
            "decay_s": 6.0,
            "read_noise_sd": 3.0,
        },
    ),
}


def spread_over_prediction(asked, trials, jobs):
    (predicted,) = predict(asked)
    (tried,) = try_all(asked, trials, seed=5, jobs=jobs)
    assert tried.identified == trials, tried.problems
    return tried.damping_spread / predicted.damping_sd


def test_the_spread_of_a_few_rendered_recordings_is_the_predicted_one():
    camera, markers, plan = SETUPS["short"]
    ratio = spread_over_prediction(request({**camera, "fps": 100}, markers, plan), 6, jobs=1)
    # Five degrees of freedom: chi-square's 0.1 % and 99.9 % points, 0.21 and 20.5, give these ratios.
    assert 0.20 < ratio < 2.03, f"rendered recordings scatter {ratio:.2f} times as predicted"


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", SETUPS)
def test_the_spread_of_a_hundred_rendered_recordings_is_the_predicted_one(name):
    ratio = spread_over_prediction(request(*SETUPS[name]), 100, jobs=2)
    # The standard deviation of a standard deviation from 100 is 7.1 %: two of them. Seen: 0.96, 1.00 and 1.14, and with
    # 98 other seeds of the last, tracked and projected on damping, 0.95.
    assert ratio == pytest.approx(1.0, abs=0.15), f"{name}: the spread is {ratio:.3f} of the prediction"

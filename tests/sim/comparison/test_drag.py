"""Air drag from videos at large amplitude: rendered frames processed by tracking, identification and simulation."""

from fractions import Fraction

import numpy as np
import pytest
from kit.identified import identification
from kit.series import POSITIONS_MM, QUICK
from scipy.integrate import quad
from scipy.optimize import brentq

from modal_id import AmplitudeDependence, IdentifySettings, identify
from sim import MEASURED_DAMPING_RATIO, paper_beam, sample_beam
from sim.beam import AncfBeam, beam_modes
from sim.comparison import AirDrag, Candidate, DragFit, DragLimit, averaged_damping_slope, compare_decay
from sim.damping import GenericDamping, StillAir, WithAirDrag
from sim.render import DotMarker, Optics, RecordingPlan, stage_recording, write_video
from tracker import Failure, TrackerSettings, displacement_series, track

DAMPING = GenericDamping(MEASURED_DAMPING_RATIO, 0.003)
DOT_MM, MM_PER_PX, EXPOSURE_S = 12.0, 2.0, 5e-4
# The base has come to rest after a tenth of a period.
STOPPED_S = 0.06


def identified_film(path, *, drag_coefficient, tip_m, fps, decay_s, seed, positions_mm=POSITIONS_MM):
    """A rendered decay of mode 1 with tip amplitude `tip_m` (linear theory), tracked and identified."""
    properties = sample_beam()
    dot = DotMarker(diameter_mm=DOT_MM, foreground=35.0, background=190.0, quiet_zone_mm=3.0)
    film = stage_recording(
        properties,
        WithAirDrag(DAMPING, StillAir(1.204, drag_coefficient)),
        RecordingPlan(mode_number=1, tip_amplitude_m=tip_m, shake_s=0.3, decay_s=decay_s),
        Optics(
            fps=Fraction(fps), mm_per_px=MM_PER_PX, exposure_s=EXPOSURE_S, background=190.0, noise_gain=0.04
        ),
        markers=(dot,) * positions_mm.size,
        positions_m=1e-3 * positions_mm,
    )
    assert film, getattr(film, "reason", "")
    write_video(path, film.frames(np.random.default_rng(seed)), fps_container=Fraction(30), codec="ffv1")
    settings = TrackerSettings(
        fps=Fraction(fps),
        mm_per_px=MM_PER_PX,
        exposure_s=EXPOSURE_S,
        kind="blob",
        size_mm=DOT_MM,
        positions_mm=tuple(positions_mm),
    )
    tracks = track(path, settings, recording=path.name)
    modes = beam_modes(AncfBeam(properties), 8)
    found = identify(
        displacement_series(tracks),
        IdentifySettings(
            mode=1,
            expected_frequencies_hz=tuple(modes.frequency_hz),
            expected_shapes=modes.transverse_at(1e-3 * positions_mm),
            onset_s=film.onset_s + STOPPED_S,
            sampler=QUICK,
        ),
    )
    assert found, getattr(found, "reason", "")
    return found


def skip_identification(series):
    """Skip the identification of simulated decays."""
    return Failure("skipped in this test", series.name)


def compared(found, drag_coefficient=None):
    """Compare with air drag; the generic model has the mean damping ratio of this decay."""
    ratios = (found.target.damping_ratio, *MEASURED_DAMPING_RATIO[1:])
    generic = GenericDamping(ratios, DAMPING.residual_ratio)
    result = compare_decay(
        sample_beam(),
        found,
        {"generic": Candidate(generic)},
        fit=skip_identification,
        air=AirDrag(generic, drag_coefficient=drag_coefficient),
    )
    assert result, getattr(result, "reason", "")
    return result


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    path = tmp_path_factory.mktemp("identified") / "air.avi"
    # Three dots determine the amplitude of one mode.
    return identified_film(
        path, drag_coefficient=2.0, tip_m=0.17, fps=60, decay_s=2.0, seed=1, positions_mm=POSITIONS_MM[1::2]
    )


def test_drag_coefficient_is_recovered_from_a_video_of_150_mm(identified):
    result = compared(identified)
    assert result.tip_amplitude_mm == pytest.approx(150.0, abs=5.0)
    fit = result.drag
    assert isinstance(fit, DragFit)
    assert fit.drag_coefficient == pytest.approx(2.0, rel=0.05)
    assert fit.drag_coefficient_q05 < 2.0 < fit.drag_coefficient_q95
    # 1 % remains at small amplitude, without drag; the mean ratio of this decay is twice that
    assert abs(fit.damping_ratio - 0.01) < 3.0 * fit.damping_ratio_sd
    assert identified.target.damping_ratio > 0.018
    frequency_hz = beam_modes(AncfBeam(sample_beam()), 1).frequency_hz[0]
    assert abs(fit.frequency_hz - frequency_hz) < 3.5 * fit.frequency_sd_hz
    # large rotation matters at this amplitude: the averaged equation of small vibrations has an error beyond its sd
    assert abs(fit.averaged - 2.0) > 3.0 * fit.averaged_sd
    generic, drag = result.models
    assert drag.model == "air_drag"
    assert drag.log_density_gain.standard_errors < -10.0
    assert drag.crps.mean < 0.2 * generic.crps.mean
    assert drag.envelope_error < 1e-3
    assert generic.envelope_error > 0.01
    assert 0.85 <= drag.coverage <= 0.97


@pytest.mark.slow
def test_given_drag_coefficient_is_not_fitted(identified):
    fit = compared(identified, 2.0).drag
    assert (fit.drag_coefficient, fit.drag_coefficient_sd) == (2.0, 0.0)
    assert abs(fit.damping_ratio - 0.01) < 3.0 * fit.damping_ratio_sd
    assert fit.damping_ratio_sd < 5e-5, "a known drag reduces the uncertainty at small amplitude"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coefficient", "seed"), [(1.0, 11), (1.0, 12), (2.0, 13), (2.0, 14), (4.0, 15), (4.0, 16)]
)
def test_drag_coefficient_is_recovered_from_other_videos(tmp_path, coefficient, seed):
    tip_m = 0.15 + 0.01 * coefficient
    found = identified_film(
        tmp_path / "air.avi", drag_coefficient=coefficient, tip_m=tip_m, fps=100, decay_s=6.0, seed=seed
    )
    fit = compared(found).drag
    assert fit.drag_coefficient == pytest.approx(coefficient, rel=0.05)
    # six cases: 99 % intervals, 1.57 times as wide as 90 % intervals
    half_width = 1.57 * 0.5 * (fit.drag_coefficient_q95 - fit.drag_coefficient_q05)
    assert abs(fit.drag_coefficient - coefficient) < half_width


def linear_decay(zeta1, zeta1_sd):
    """Mode 1 at 5 mm by linear theory, with an identified slope of the damping ratio."""
    positions = np.array([90.0, 190.0, 290.0, 390.0, 490.0])
    modes = beam_modes(AncfBeam(sample_beam()), 1)
    shape = modes.transverse_at(1e-3 * positions)[:, 0]
    time_s = np.arange(150) / 100.0
    mode = (modes.frequency_hz[0], 0.01, 5.0 * shape / shape.max() + 0j, 1)
    found = identification([mode], time_s=time_s, positions_mm=positions, fit_from_s=0.0)
    dependence = AmplitudeDependence(
        0.01, 1e-5, zeta1, zeta1_sd, modes.frequency_hz[0], 1e-5, 0.0, 1e-5, significant=False
    )
    object.__setattr__(found.modes[0], "amplitude_dependence", dependence)
    return found


def test_decay_without_drag_gives_an_upper_limit():
    found = linear_decay(0.0, 1e-5)
    limit = compared(found).drag
    assert isinstance(limit, DragLimit)
    assert not limit
    modes = beam_modes(AncfBeam(sample_beam()), 1)
    tip = modes.transverse_at(np.array([0.49]))[0, 0]
    slope = averaged_damping_slope(modes, 1, 1.204) * 5e-3 / tip
    # 95 % quantile of a half-normal distribution
    assert limit.drag_coefficient_q95 == pytest.approx(1.96 * 1e-5 / slope, rel=1e-3)


def test_averaged_slope_matches_a_euler_bernoulli_cantilever():
    """2 / (3 pi) rho b int |phi|^3 dx with the Euler-Bernoulli shape of a beam without gravity."""
    root = brentq(lambda b: np.cosh(b) * np.cos(b) + 1.0, 1.5, 2.5)
    ratio = (np.sinh(root) - np.sin(root)) / (np.cosh(root) + np.cos(root))

    def shape(x):
        return np.cosh(root * x) - np.cos(root * x) - ratio * (np.sinh(root * x) - np.sin(root * x))

    beam = paper_beam(orientation="none")
    mass = 8000.0 * 5e-3 * 0.5e-3 * 0.5
    integral = 0.5 * quad(lambda x: abs(shape(x)) ** 3, 0.0, 1.0)[0] / mass**1.5
    expected = 2.0 / (3.0 * np.pi) * 1.204 * 5e-3 * integral
    modes = beam_modes(AncfBeam(beam), 1)
    assert averaged_damping_slope(modes, 1, 1.204) == pytest.approx(expected, rel=1e-4)

"""Effects of real test set-ups: elastic clamps, attached masses, inclination, air drag, base motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from support.exact_curvature import ExactCurvatureBeam
from support.paths import REALDATA, REALDATA_ABSENT, ROOT, script

from sim import paper_beam
from sim.beam import (
    AncfBeam,
    BeamProperties,
    BuckledBeamError,
    ElasticClamp,
    PointMass,
    beam_modes,
    static_equilibrium,
)
from sim.damping import GenericDamping, NoDamping, StillAir, WithAirDrag
from sim.dynamics import BaseMotion, State, released_state, simulate

L, EI = 0.5, 210e9 * 5e-3 * 0.5e-3**3 / 12.0
TIP = np.array([L])


def frequencies(properties, count=5, **options):
    return beam_modes(AncfBeam(properties, **options), count).frequency_hz


def spring_clamped_roots(spring, count):
    """beta L of a weightless beam on a rotational spring: EI w'' = k w' and w = 0 at the root, free tip."""

    def determinant(x):
        c, s, ch, sh = np.cos(x), np.sin(x), np.cosh(x), np.sinh(x)
        r = EI * x / L / spring
        value = (c + ch - 2 * r * s) * (c + ch) - (sh - s - 2 * r * c) * (s + sh)
        return value / ch

    grid = np.linspace(0.2, np.pi * (count + 0.5), 4000)
    values = [determinant(x) for x in grid]
    found = [
        brentq(determinant, a, b, xtol=1e-13)
        for a, b, fa, fb in zip(grid[:-1], grid[1:], values[:-1], values[1:], strict=True)
        if fa * fb < 0.0
    ]
    return np.array(found[:count])


@pytest.mark.parametrize("spring", [0.05, 1.0, 50.0])
def test_rotational_clamp_stiffness_gives_the_frequencies_of_beam_theory(spring):
    found = frequencies(replace(paper_beam("none"), clamp=ElasticClamp(spring)))
    theory = spring_clamped_roots(spring, 5) ** 2 / L**2 * np.sqrt(EI / (8000 * 2.5e-6)) / (2 * np.pi)
    np.testing.assert_allclose(found, theory, rtol=2e-4, err_msg="20 elements, as for the rigid clamp")


def test_stiff_elastic_clamp_approaches_the_rigid_clamp():
    for orientation in ("hanging", "horizontal"):
        rigid = frequencies(paper_beam(orientation))
        elastic = frequencies(replace(paper_beam(orientation), clamp=ElasticClamp(1e5)))
        # the remaining flexibility is 2e-7 (EI / k L); the spring does not constrain the axial strain of the first
        # element, which contributes a tenth of the mesh error if weight bends the beam
        np.testing.assert_allclose(elastic, rigid, rtol=2e-5)


def test_transverse_clamp_stiffness_lowers_the_first_frequency_by_rayleighs_quotient():
    """1 / omega^2 increases by (generalised root force)^2 / k; the root shear is the integral of omega^2 phi m."""
    properties = paper_beam("none")
    modes = beam_modes(AncfBeam(properties), 1)
    stiffness = 2e3
    soft = frequencies(replace(properties, clamp=ElasticClamp(1e5, stiffness)), 1)[0]
    shear = modes.omega_rad_s[0] ** 2 * modes.base_participation()[0]
    predicted = modes.frequency_hz[0] * np.sqrt(1.0 - shear**2 / stiffness / modes.omega_rad_s[0] ** 2)
    assert soft / modes.frequency_hz[0] - 1.0 == pytest.approx(
        predicted / modes.frequency_hz[0] - 1.0, rel=2e-2
    )


def test_static_rotation_of_an_elastic_clamp():
    spring = 0.5
    beam = AncfBeam(replace(paper_beam("none"), clamp=ElasticClamp(spring)))
    load = np.zeros(beam.ndof)
    load[-3] = 1e-4
    q = static_equilibrium(beam, load)
    # root rotation P L / k, tip deflection P L^3 / 3 EI + P L^2 / k; at rotations of 1e-4, linear within 1e-8
    assert q[3] == pytest.approx(1e-4 * L / spring, rel=1e-5)
    assert q[-3] == pytest.approx(1e-4 * (L**3 / (3 * EI) + L**2 / spring), rel=1e-5)


def test_beam_in_an_elastic_clamp_vibrates_at_its_natural_frequency():
    beam = AncfBeam(replace(paper_beam(), clamp=ElasticClamp(0.3)))
    modes = beam_modes(beam, 8)
    period = 1.0 / modes.frequency_hz[0]
    run = simulate(
        beam, NoDamping(), state=released_state(beam, modes, 1, 1e-3), duration_s=period, step_s=period / 200,
        output_positions_m=TIP, modes=modes,
    )  # fmt: skip
    # initial position after one period, within 1e-5 for amplitude dependence and other modes in the static shape
    assert run.transverse_m[-1, 0] == pytest.approx(1e-3, rel=1e-4)
    assert run.energy_j[-1] == pytest.approx(run.energy_j[0], rel=1e-8)


def test_rotary_inertia_lowers_frequencies_by_rayleighs_quotient():
    properties = paper_beam("none")
    beam = AncfBeam(properties)
    modes = beam_modes(beam, 3)
    inertia = 1e-8
    at = 0.37
    body = PointMass(at, 0.0, inertia)
    slopes = (beam.interpolation(np.array([at]), 1) @ modes.phi[1::2])[0]
    predicted = modes.frequency_hz / np.sqrt(1.0 + inertia * slopes**2)
    # second order in the relative inertia, 1e-4, relative to the change
    found = frequencies(replace(properties, point_masses=(body,)), 3)
    np.testing.assert_allclose(found / modes.frequency_hz - 1, predicted / modes.frequency_hz - 1, rtol=2e-3)


@pytest.mark.parametrize(("angle", "same"), [(0.0, "hanging"), (90.0, "horizontal"), (180.0, "standing")])
def test_angled_beam_matches_the_named_orientations(angle, same):
    angled = replace(paper_beam(), orientation="angled", angle_deg=angle)
    np.testing.assert_allclose(frequencies(angled), frequencies(paper_beam(same)), rtol=1e-6)


def test_beam_at_60_degrees_sags_and_is_rotated_in_the_image():
    beam = AncfBeam(replace(paper_beam(), orientation="angled", angle_deg=60.0))
    x, y, angle = beam.points(TIP, np.zeros(beam.ndof))
    assert (x[0], y[0], angle[0]) == pytest.approx((0.5 * np.sin(np.pi / 3), -0.25, 0.0))
    _, sagged, rotation = beam.points(TIP, static_equilibrium(beam))
    assert sagged[0] < y[0] - 0.02
    assert rotation[0] < 0.0, "weight rotates a beam that points right clockwise"
    mirrored = AncfBeam(replace(paper_beam(), orientation="angled", angle_deg=-60.0))
    np.testing.assert_allclose(frequencies(mirrored.properties), frequencies(beam.properties), rtol=1e-9)


def test_buckled_angled_beam_is_an_error():
    tall = replace(paper_beam(), orientation="angled", angle_deg=180.0, length_m=0.8)
    with pytest.raises(BuckledBeamError, match="buckles under its own weight"):
        frequencies(tall)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"orientation": "angled"}, 'orientation "angled" needs a finite angle_deg'),
        ({"angle_deg": 30.0}, "got 30.0 with 'hanging'"),
    ],
)
def test_angle_requires_an_angled_beam(change, message):
    with pytest.raises(ValueError, match=message):
        replace(paper_beam(), **change)


@pytest.mark.parametrize("values", [(0.0, None), (1.0, -1.0), (float("nan"), None)])
def test_invalid_clamps_are_refused(values):
    with pytest.raises(ValueError, match="of an elastic clamp must be finite and positive"):
        ElasticClamp(*values)


def test_a_negative_rotary_inertia_is_refused():
    with pytest.raises(ValueError, match="rotary_inertia_kg_m2 of a point mass"):
        PointMass(0.1, 1e-3, -1.0)


def test_exact_and_approximate_curvature_agree_for_a_thin_beam():
    simple, exact = frequencies(paper_beam()), beam_modes(ExactCurvatureBeam(paper_beam()), 5).frequency_hz
    # EI (d eps / dx)^2 and the axial strain due to weight, 4e-7
    np.testing.assert_allclose(exact, simple, rtol=1e-6)
    load = np.zeros(80)
    load[-3] = 10.0 * EI / L**2
    tips = [
        static_equilibrium(beam(paper_beam("none"), 5), load)[-4:-2]
        for beam in (AncfBeam, ExactCurvatureBeam)
    ]
    np.testing.assert_allclose(tips[0], tips[1], atol=1e-6 * L)


def test_derivatives_of_the_exact_curvature():
    beam = ExactCurvatureBeam(paper_beam())
    rng = np.random.default_rng(0)
    q, direction = rng.normal(size=(2, 80)) * np.array([[3e-3], [1.0]]) / beam.dof_scale
    h = 1e-6
    up, down, here = beam.elastic(q + h * direction), beam.elastic(q - h * direction), beam.elastic(q)
    assert (up.energy_j - down.energy_j) / (2 * h) == pytest.approx(here.force_n @ direction, rel=1e-5)
    dense = np.zeros((80, 80))
    for k in range(-7, 8):
        i = np.arange(max(0, -k), min(80, 80 - k))
        dense[i, i + k] = here.tangent[i, k + 7]
    want = (up.force_n - down.force_n) / (2 * h)
    np.testing.assert_allclose(dense @ direction, want, atol=1e-5 * np.abs(want).max())


def test_more_gauss_points_give_the_same_result():
    """Exact integration takes four points for mass, two for bending, five for axial energy (polynomial degree 8)."""
    beam5, beam8 = (AncfBeam(paper_beam(), points) for points in (5, 8))
    q = np.random.default_rng(2).normal(size=80) * 1e-2 / beam5.dof_scale
    assert beam8.elastic(q).energy_j == pytest.approx(beam5.elastic(q).energy_j, rel=1e-12)
    exact = ExactCurvatureBeam(paper_beam("none"))
    rolled = static_equilibrium(exact, tip_moment_n_m=2.0 * np.pi * EI / L)
    assert np.hypot(rolled[-4] + L, rolled[-3]) < 1e-4 * L, (
        "the integration points of the curvature suffice for a full circle"
    )


def drag_ratio(beam, modes, air):
    """Damping ratio of the first mode per metre of tip amplitude: 2 / (3 pi) rho c_d int b |phi|^3 dx / phi(L)."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    phi = np.abs(modes.transverse_at(0.5 * L * (nodes + 1.0))[:, 0])
    cubed = 0.5 * L * np.sum(weights * phi**3) * 5e-3
    tip = modes.transverse_at(TIP)[0, 0]
    return 2.0 / (3.0 * np.pi) * air.density_kg_m3 * air.drag_coefficient * cubed / tip


@pytest.mark.parametrize("step_s", [2e-3, 5e-4])
def test_air_drag_damping_is_proportional_to_amplitude(step_s):
    beam = AncfBeam(paper_beam())
    modes = beam_modes(beam, 8)
    air = StillAir(drag_coefficient=4.0)
    run = simulate(
        beam, WithAirDrag(NoDamping(), air), state=released_state(beam, modes, 1, 5e-3), duration_s=8.0, step_s=step_s,
        output_positions_m=TIP, modes=modes,
    )  # fmt: skip
    rest = beam.elastic(modes.equilibrium).energy_j - beam.weight_load_n @ modes.equilibrium
    amplitude = np.sqrt((run.energy_j[-1] - rest) / (run.energy_j[0] - rest))
    ratio = drag_ratio(beam, modes, air) * 5e-3
    expected = 1.0 / (1.0 + ratio * modes.omega_rad_s[0] * 8.0)
    assert expected < 0.95
    # average over cycles; the incomplete last cycle adds an error of a quarter of its loss, 0.1 % of the total
    assert 1.0 - amplitude == pytest.approx(1.0 - expected, rel=0.02)


def test_drag_deflects_a_beam_moving_at_constant_speed():
    """A base moving transversely at constant speed gives the static deflection under rho c_d b V^2 / 2."""
    beam = AncfBeam(paper_beam("none"))
    modes = beam_modes(beam, 8)
    steps, step_s, speed = 4000, 2e-3, 1.0
    base = BaseMotion(np.arange(steps + 1) * step_s * speed, np.full(steps + 1, speed))
    damping = WithAirDrag(GenericDamping((0.5,) * 5), StillAir(1.2, 2.0))
    run = simulate(
        beam, damping, state=State(np.zeros(80), np.zeros(80)), duration_s=steps * step_s, step_s=step_s,
        output_positions_m=TIP, modes=modes, base=base, axial_relaxation_s=1e-3,
    )  # fmt: skip
    deflection = 0.5 * 1.2 * 2.0 * 5e-3 * speed**2 * L**4 / (8.0 * EI)
    # the deflection rotates the normal by deflection / L = 4 %; the error is twice its square
    assert run.transverse_m[-1, 0] == pytest.approx(-deflection, rel=6e-3)


def test_invalid_air_is_refused():
    with pytest.raises(ValueError, match="density_kg_m3 must be finite"):
        StillAir(-1.0)


def test_an_angled_uniform_beam_can_be_built():
    beam = BeamProperties.uniform(
        length_m=0.5, width_m=5e-3, thickness_m=5e-4, density_kg_m3=8000.0, elastic_modulus_pa=210e9,
        orientation="angled", angle_deg=45.0, clamp=ElasticClamp(1.0),
    )  # fmt: skip
    assert AncfBeam(beam).ndof == 84


CANTILEVER_PAGE = ROOT / "docs" / "studies" / "cantilever.md"
CANTILEVER_DATA = REALDATA / "al_cantilever"


@pytest.fixture(scope="module")
def cantilever():
    return script(CANTILEVER_PAGE.with_suffix(".py"))


@pytest.fixture(scope="module")
def cantilever_text():
    return CANTILEVER_PAGE.read_text(encoding="utf-8")


def numbers(row):
    return [float(value) for cell in row[1:] for value in cell.split(" ± ") if value]


# Fast: one of the fits of the other table, in the test of two lengths and two modes.
@pytest.mark.parametrize("name", ["errors", pytest.param("posterior", marks=pytest.mark.slow)])
def test_cantilever_page_prints_the_computed_values(cantilever, cantilever_text, name):
    found = cantilever.measured_on(cantilever_text)
    printed, computed = (
        cantilever.rows_of(cantilever_text, name),
        getattr(cantilever, f"{name}_table")(found),
    )
    assert [row[0] for row in printed] == [row[0] for row in computed]
    assert printed[0] == computed[0]
    for ours, theirs in zip(computed[1:], printed[1:], strict=True):
        # tolerance for frequencies rounded to 1e-4 Hz, up to 2e-5 relative, and for the last printed digit
        assert numbers(ours) == pytest.approx(numbers(theirs), rel=0.01, abs=0.011), f"{name}: {theirs[0]}"


def test_one_modulus_and_clamp_predict_both_lengths_within_measurement_error(cantilever, cantilever_text):
    found = cantilever.measured_on(cantilever_text)
    measured = np.array([m.frequency_hz for m in found])
    rigid = cantilever.all_four_hz(cantilever.Strip()) / measured - 1.0
    assert rigid.min() > 0.05, "with rigid clamp and handbook modulus, all frequencies are clearly too high"
    # 1 mm of free length, error of beam theory for a wide strip, and scatter of repeats
    allowed = np.hypot(2e-3 / np.repeat(cantilever.LENGTHS_M, 2), cantilever.plate_effect())
    allowed = np.hypot(allowed, [m.sd_hz / m.frequency_hz for m in found])
    for orientation in ("none", "hanging"):
        fitted = cantilever.fit(found, sensor=False, orientation=orientation).strip
        error = cantilever.all_four_hz(fitted) / measured - 1.0
        assert np.all(np.abs(error) < allowed), f"{orientation}: error {error}, allowed {allowed}"


def test_lengths_excluded_from_the_fit_are_predicted(cantilever, cantilever_text):
    fitted = cantilever.fit(cantilever.measured_on(cantilever_text), sensor=True).strip
    for length, authors_hz in cantilever.AUTHORS_HZ.items():
        error = cantilever.frequencies_hz(fitted, length) / authors_hz - 1.0
        # twice the root sum of squares of 1 mm, half the spectral resolution and the largest plate effect at 30 cm
        line = 0.025 / np.array(authors_hz)
        allowed = 2.0 * np.sqrt((2e-3 / length) ** 2 + line**2 + cantilever.plate_effect()[:2] ** 2)
        assert np.all(np.abs(error) < allowed), f"{length} m: error {error}, allowed {allowed}"


def test_properties_determined_by_two_lengths_and_two_modes(cantilever, cantilever_text):
    # the page's table of all orientations of the strip, verified in the test of the page above
    header, *rows = cantilever.rows_of(cantilever_text, "posterior")
    chi_square = {row[0]: float(row[header.index("chi2")]) for row in rows}
    # four frequencies plus six priors minus six unknowns: 95 % quantile of chi-square with 4 dof is 9.49
    assert max(chi_square["sideways"], chi_square["hanging"]) < 9.49 < chi_square["standing"]
    one = cantilever.fit(cantilever.measured_on(cantilever_text), sensor=True, nuisances=True)
    sd = np.sqrt(np.diag(one.covariance))
    assert sd[0] < 0.3 * cantilever.PRIOR_SD[0], "the frequencies determine the modulus"
    assert np.all(sd[3:5] > 0.9 * cantilever.PRIOR_SD[3:5]), "the priors determine the free lengths"
    assert one.covariance[0, 1] < -0.85 * sd[0] * sd[1], "modulus and clamp stiffness are correlated"


def test_fit_recovers_known_properties(cantilever):
    truth = cantilever.Strip(modulus=0.93, clamp_n_m=250.0, sensor=0.9)
    found = [cantilever.Measured("", f, 1e-6 * f) for f in cantilever.all_four_hz(truth)]
    one = cantilever.fit(found, sensor=True)
    error = np.log(
        [
            one.strip.modulus / truth.modulus,
            one.strip.clamp_n_m / truth.clamp_n_m,
            one.strip.sensor / truth.sensor,
        ]
    )
    # without noise only the priors bias the fit; their offsets are 0.7 (modulus) and 0.5 (sensor) standard deviations
    sd = np.sqrt(np.diag(one.covariance)[:3])
    assert np.all(np.abs(error) < np.hypot(0.73, 0.53) * sd), f"error {error}, sd {sd}"
    assert sd[0] < 0.03


needs_the_recordings = pytest.mark.skipif(not CANTILEVER_DATA.is_dir(), reason=REALDATA_ABSENT)


@needs_the_recordings
@pytest.mark.parametrize(
    ("row", "pattern", "guess_hz", "options"),
    [
        (1, "30cm*21-13-02*", 108.0, {"between_s": (0.1, 0.9), "every": 1, "max_modes": 3}),
        pytest.param(2, "50cm*11-47-59*", 6.0, {"max_modes": 2}, marks=pytest.mark.slow),
        pytest.param(3, "50cm*11-47-59*", 39.0, {"max_modes": 2}, marks=pytest.mark.slow),
    ],
)
def test_recordings_of_the_cantilever_give_the_frequencies_on_the_page(
    cantilever, cantilever_text, row, pattern, guess_hz, options
):
    page = cantilever.measured_on(cantilever_text)[row]
    modes = cantilever.modes_in(CANTILEVER_DATA, pattern, target_frequency_hz=guess_hz, **options)
    # one of two or three repeats deviates from the mean by at most 1.15 of their standard deviation, plus rounding
    assert cantilever._near(modes, guess_hz) == pytest.approx(page.frequency_hz, abs=1.16 * page.sd_hz + 1e-4)


@needs_the_recordings
@pytest.mark.slow
def test_cantilever_page_has_the_identified_frequencies(cantilever, cantilever_text):
    for ours, page in zip(
        cantilever.measured(CANTILEVER_DATA), cantilever.measured_on(cantilever_text), strict=True
    ):
        assert ours.name == page.name
        assert ours.frequency_hz == pytest.approx(page.frequency_hz, abs=2e-4)
        assert ours.sd_hz == pytest.approx(page.sd_hz, abs=2e-4)

"""Beams held otherwise than a cantilever: exact frequencies, rigid-body motions, decays, contradictions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ellipk
from support.beams import first_roots

from sim import paper_beam
from sim.beam import AncfBeam, ElasticClamp, NoEquilibriumError, PointMass, beam_modes, static_equilibrium
from sim.damping import GenericDamping, NoDamping
from sim.dynamics import longest_step_s, released_state, simulate, state_from_modes
from sim.updating import BeamFamily

BEAM = paper_beam("none")
STIFFNESS = BEAM.elastic_modulus_pa * BEAM.second_moment_m4[0]
LINE_MASS = BEAM.density_kg_m3 * BEAM.area_m2[0]


def conditions(end, at, beta, sign):
    """Two rows that vanish for a shape with these values of w, w'/b, w''/b^2, w'''/b^3 (columns) at an end.

    `end` is a name, a clamp of two springs, or a body; `sign` is 1 at the first end and -1 at the second.
    """
    w, slope, moment, shear = at
    if isinstance(end, ElasticClamp):
        turn, move = (
            k / (STIFFNESS * beta**n) for k, n in ((end.rotation_n_m_rad, 1), (end.translation_n_m, 3))
        )
        return moment - turn * slope, shear + move * w
    if isinstance(end, PointMass):
        square = beta**4 * STIFFNESS / LINE_MASS
        turn, move = (
            k * square / (STIFFNESS * beta**n) for k, n in ((end.rotary_inertia_kg_m2, 1), (end.mass_kg, 3))
        )
        return moment + sign * turn * slope, shear - sign * move * w
    return {"clamped": (w, slope), "pinned": (w, moment), "free": (moment, shear), "guided": (slope, shear)}[
        end
    ]


def theory_hz(ends, count, length=BEAM.length_m):
    """Frequencies of Euler and Bernoulli's beam: zeros of the determinant of its four conditions."""

    def determinant(x):
        beta, rows = x / length, []
        for end, place, sign in ((ends[0], 0.0, 1), (ends[1], x, -1)):
            c, s, near, far = np.cos(place), np.sin(place), np.exp(-place), np.exp(place - x)
            values = [[c, s, near, far], [-s, c, -near, far], [-c, -s, near, far], [s, -c, -near, far]]
            rows += conditions(end, np.array(values), beta, sign)
        return np.linalg.det(rows)

    return (first_roots(determinant, count) / length) ** 2 * np.sqrt(STIFFNESS / LINE_MASS) / (2.0 * np.pi)


PAIRS = [
    "clamped clamped",
    "clamped pinned",
    "clamped free",
    "clamped guided",
    "pinned pinned",
    "pinned free",
]
PAIRS += ["pinned guided", "free free", "free guided", "guided guided", "guided clamped", "free pinned"]
SPRINGS = ElasticClamp(0.5, 300.0)
BODY = PointMass(0.5, 4e-3, 2e-7)


@pytest.mark.parametrize("ends", [*PAIRS, "springs free", "clamped body"])
def test_frequencies_are_those_of_theory(ends):
    first, second = ends.split()
    bodies = {"springs": SPRINGS, "body": BODY}
    beam = paper_beam("none", 160)
    if first == "springs":
        beam = replace(beam, clamp=SPRINGS)
    elif second == "body":
        beam = replace(beam, point_masses=(BODY,))
    else:
        beam = replace(beam, ends=(first, second))
    found = beam_modes(AncfBeam(beam), 2).frequency_hz
    error = found / theory_hz([bodies.get(end, end) for end in (first, second)], 2) - 1.0
    assert np.abs(error).max() < 1e-8, (
        f"160 cubic elements are too stiff by (beta h)^4 / 1440, 4e-9 for beta L = 7.9; got {error}"
    )


@pytest.mark.parametrize("ends", ["free free", "pinned free", "guided pinned", "clamped clamped"])
def test_the_family_of_the_updating_has_the_same_modes(ends):
    beam = replace(paper_beam("none", 12), ends=tuple(ends.split()))
    np.testing.assert_allclose(
        BeamFamily(beam, 4).modes(np.zeros(26)).frequency_hz[0],
        beam_modes(AncfBeam(beam), 4).frequency_hz,
        rtol=1e-11,
        err_msg="one element, two assemblies: rounding only",
    )


@pytest.mark.parametrize(
    ("ends", "motions"),
    [
        ("free free", ("translation", "rotation")),
        ("pinned free", ("rotation",)),
        ("guided free", ("translation",)),
        ("guided pinned", ()),
        ("clamped free", ()),
    ],
)
def test_motions_of_the_rigid_beam_have_no_number(ends, motions):
    beam = AncfBeam(replace(BEAM, ends=tuple(ends.split())))
    modes = beam_modes(beam, 3)
    assert beam.properties.rigid_body_motions == motions
    assert ("rigid-body" in repr(modes)) == bool(motions)
    along = np.linspace(0.0, 0.5, 21)
    rigid = {"translation": np.ones(21), "rotation": along}
    moved = np.zeros((beam.ndof + beam.held, len(motions)))
    for k, name in enumerate(motions):
        moved[1::4, k], moved[3::4, k] = rigid[name], name == "rotation"
    work = modes.phi.T @ beam.mass_matrix() @ moved[beam.held :]
    # an eigenvector is off by the rounding of the highest eigenvalue, 1e-16 (ne / 1.5)^4 of the lowest
    np.testing.assert_allclose(work, 0.0, atol=1e-9, err_msg="bending carries no momentum")


@pytest.mark.parametrize(("ends", "orientation"), [("free free", "none"), ("pinned free", "hanging")])
def test_a_beam_with_free_ends_decays_about_its_place(ends, orientation):
    beam = AncfBeam(replace(paper_beam(orientation), ends=tuple(ends.split())))
    modes, ratio, amplitude = beam_modes(beam, 8), 0.01, 1e-4
    omega, at = modes.omega_rad_s[0], modes.antinode_m(1)
    run = simulate(
        beam,
        GenericDamping((ratio,) * 5),
        state=released_state(beam, modes, 1, amplitude),
        duration_s=10.0 * 2.0 * np.pi / omega,
        step_s=longest_step_s(omega),
        output_positions_m=at,
        modes=modes,
    )
    pole = omega * (-ratio + 1j * np.sqrt(1.0 - ratio**2))
    # at rest at the start
    theory = amplitude * np.real((1.0 + 1j * pole.real / pole.imag) * np.exp(pole * run.time_s))
    error = np.abs(run.transverse_m[:, 0] - theory).max() / amplitude
    assert error < 3e-4, (
        f"the anchor of rigid-body motions turns a beam of 0.2 mm by 3e-4 of that; got {error}"
    )


@pytest.mark.parametrize("tension_n", [20.0, 0.1, -0.3])
def test_tension_of_a_pinned_beam_stiffens_it(tension_n):
    beam = replace(paper_beam("none", 160), ends=("pinned", "pinned"), tension_n=tension_n)
    n = np.arange(1, 3)
    wave = n * np.pi / BEAM.length_m
    theory = wave / (2.0 * np.pi) * np.sqrt((tension_n + wave**2 * STIFFNESS) / LINE_MASS)
    error = beam_modes(AncfBeam(beam), 2).frequency_hz / theory - 1.0
    assert np.abs(error).max() < 1e-8, f"as without tension, 160 elements leave at most 2e-9; got {error}"


def test_compression_buckles_a_clamped_beam_at_eulers_load():
    load = 4.0 * np.pi**2 * STIFFNESS / BEAM.length_m**2
    held = replace(BEAM, ends=("clamped", "clamped"))
    soft = beam_modes(AncfBeam(replace(held, tension_n=-0.9999 * load)), 1).frequency_hz[0]
    assert soft < 0.02 * beam_modes(AncfBeam(held), 1).frequency_hz[0], (
        "the square falls linearly with the load"
    )
    # 20 elements are too stiff by (beta h)^4 / 720 in the square: 1e-5 for beta L = 2 pi
    with pytest.raises(NoEquilibriumError, match=r"unstable.*tension"):
        static_equilibrium(AncfBeam(replace(held, tension_n=-1.0001 * load)))


def test_a_beam_in_tension_decays_at_its_frequency():
    beam = AncfBeam(replace(BEAM, ends=("pinned", "clamped"), tension_n=10.0))
    modes = beam_modes(beam, 8)
    omega = modes.omega_rad_s[0]
    run = simulate(
        beam,
        NoDamping(),
        state=released_state(beam, modes, 1, 1e-6),
        duration_s=10.0 * 2.0 * np.pi / omega,
        step_s=longest_step_s(omega),
        output_positions_m=modes.antinode_m(1),
        modes=modes,
    )
    error = np.abs(run.transverse_m[:, 0] / 1e-6 - np.cos(omega * run.time_s)).max()
    # a micrometre adds 3e-12 m of stretch: EA / L of that is 3e-6 N
    assert error < 1e-4, f"a small motion has the frequency of the modes over ten periods; got {error}"


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_a_beam_that_cannot_shorten_stiffens_with_amplitude(ratio):
    """Woinowsky-Krieger (1950): one mode of a pinned beam is Duffing's oscillator, ``u'' + w^2 (u + u^3 / 4 r^2) = 0``.

    r is the radius of gyration, and the axial force is that of the mean stretch.
    """
    beam = AncfBeam(replace(BEAM, ends=("pinned", "pinned")))
    modes = beam_modes(beam, 8)
    amplitude = ratio * BEAM.thickness_m[0] / np.sqrt(12.0)
    period = 2.0 * np.pi / modes.omega_rad_s[0]
    run = simulate(
        beam,
        NoDamping(),
        state=released_state(beam, modes, 1, amplitude),
        duration_s=2.0 * period,
        step_s=2e-4,
        output_positions_m=np.array([0.25]),
        modes=modes,
    )
    moved = run.transverse_m[:, 0]
    at = np.flatnonzero(moved[:-1] * moved[1:] < 0.0)
    crossing = run.time_s[at] + 2e-4 * moved[at] / (moved[at] - moved[at + 1])
    stiffer = ratio**2 / 4.0
    expected = period / np.pi * 2.0 * ellipk(0.5 * stiffer / (1.0 + stiffer)) / np.sqrt(1.0 + stiffer)
    error = 2.0 * (crossing[2] - crossing[0]) / (2.0 * expected) - 1.0
    slope = np.pi * amplitude / BEAM.length_m
    assert abs(error) < 2.0 * slope**2, (
        f"theory has no motion along the beam, of the order of w'^2; got {error}"
    )


def test_ends_that_move_with_the_frame_do_not_move_in_it():
    beam = AncfBeam(replace(BEAM, ends=("pinned", "clamped")))
    modes = beam_modes(beam, 4)
    state = state_from_modes(beam, modes, np.array([1e-5, 0.0]), np.array([0.0, 1e-3]))
    assert np.all(modes.phi[beam.fixed] == 0.0)
    bent = np.abs(beam.transverse_at(np.array([0.25]), state.q))[0]
    held = np.abs(state.q * beam.dof_scale)[beam.fixed].max()
    assert held < 1e-12 * bent, "bending of mode 1 has 1e-7 of EA / h, the spring 1e9 times EA / h"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ends": ("clamped", "loose")}, "ends must be two of clamped, pinned, free, guided"),
        (
            {"ends": ("pinned", "free"), "clamp": SPRINGS},
            "an elastic clamp is the first end .* needs it clamped",
        ),
        ({"tension_n": 3.0}, "a tension of 3.0 N needs two ends that hold the beam along its axis"),
        ({"ends": ("free", "free"), "orientation": "hanging"}, 'against its weight: .*orientation "none"'),
        ({"ends": ("pinned", "free"), "orientation": "horizontal"}, "got the ends 'pinned' and 'free' with"),
    ],
)
def test_contradictions_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        replace(BEAM, **changes)

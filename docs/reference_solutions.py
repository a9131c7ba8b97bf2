"""Reference solutions for verifying the simulation: beam theory, elastica, energy and damping of decays.

Used by the verification page and the tests.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from sim.beam import AncfBeam, BeamModes, BeamProperties, from_band
from sim.damping import DampingModel, NoDamping, RayleighDamping
from sim.dynamics import FailedSimulation, State, Trajectory, simulate, state_from_modes
from tracker import FloatArray

TIP = np.array([0.5])


def cantilever_roots(count: int) -> FloatArray:
    """Roots beta_n L of the clamped-free beam, cos(x) cosh(x) = -1."""
    guesses = [1.875, *((np.pi * (n - 0.5)) for n in range(2, count + 1))]
    return np.array(
        [brentq(lambda x: np.cos(x) + 1.0 / np.cosh(x), g - 0.3, g + 0.3, xtol=1e-14) for g in guesses]
    )


def euler_bernoulli_hz(properties: BeamProperties, count: int) -> FloatArray:
    """Natural frequencies of a uniform cantilever without gravity, shear and rotary inertia."""
    stiffness = properties.elastic_modulus_pa * properties.second_moment_m4[0]
    line_mass = properties.density_kg_m3 * properties.area_m2[0]
    beta = cantilever_roots(count) / properties.length_m
    return beta**2 * np.sqrt(stiffness / line_mass) / (2.0 * np.pi)


def rayleigh_ritz_hz(properties: BeamProperties, count: int, *, tension_sign: float) -> FloatArray:
    """Natural frequencies of a uniform cantilever in tension (+1, hanging) or compression (-1, standing) by its weight.

    The trial functions are x^2 times Legendre polynomials over the full length; the axial force is
    tension_sign rho A g (L - x).
    """
    terms = 18
    nodes, weights = np.polynomial.legendre.leggauss(60)
    length = properties.length_m
    x, w = 0.5 * (nodes + 1.0), 0.5 * weights
    polynomials = [
        np.polynomial.Polynomial([0, 0, 1])
        * np.polynomial.Legendre.basis(n, domain=[0, 1]).convert(kind=np.polynomial.Polynomial)
        for n in range(terms)
    ]
    value = np.array([p(x) for p in polynomials])
    slope = np.array([p.deriv(1)(x) for p in polynomials]) / length
    curve = np.array([p.deriv(2)(x) for p in polynomials]) / length**2
    stiffness = properties.elastic_modulus_pa * properties.second_moment_m4[0]
    line_mass = properties.density_kg_m3 * properties.area_m2[0]
    tension = tension_sign * line_mass * properties.gravity_m_s2 * length * (1.0 - x)
    k = length * ((curve * w * stiffness) @ curve.T + (slope * w * tension) @ slope.T)
    m = length * (value * w * line_mass) @ value.T
    scale = 1.0 / np.sqrt(np.diag(m))
    square = eigh(k * np.outer(scale, scale), m * np.outer(scale, scale), eigvals_only=True)
    return np.sqrt(square[:count]) / (2.0 * np.pi)


def small_decay(
    beam: AncfBeam,
    modes: BeamModes,
    damping: DampingModel,
    number: int,
    step_s: float,
    duration_s: float = 2.0,
) -> Trajectory | FailedSimulation:
    """Decay of one mode from a tip displacement of 10 um; amplitude changes shape and frequency by less than 1e-7."""
    coordinate = np.zeros(number)
    coordinate[-1] = 1e-5 / modes.transverse_at(TIP)[0, number - 1]
    state = state_from_modes(beam, modes, coordinate, np.zeros(number))
    return simulate(
        beam, damping, state=state, duration_s=duration_s, step_s=step_s, output_positions_m=TIP, modes=modes
    )


def damping_and_frequency_error(run: Trajectory, omega: float, zeta: float) -> tuple[float, float]:
    """Relative errors of damping ratio and frequency, by linear least squares at the prescribed pole."""
    exponent = omega * complex(-zeta, np.sqrt(1.0 - zeta**2))
    decay = np.exp(exponent * run.time_s)
    columns = np.stack([decay.real, decay.imag, (run.time_s * decay).real, (run.time_s * decay).imag], axis=1)
    a, b, c, d = np.linalg.lstsq(columns, run.transverse_m[:, 0], rcond=None)[0]
    shift = complex(c, -d) / complex(a, -b)
    return (-shift.real / (zeta * omega) if zeta else -shift.real / omega), shift.imag / omega


def energy_damping_ratio(run: Trajectory, beam: AncfBeam, modes: BeamModes, frequency_hz: float) -> float:
    rest = beam.elastic(modes.equilibrium).energy_j - beam.weight_load_n @ modes.equilibrium
    log_energy_ratio = np.log((run.energy_j[0] - rest) / (run.energy_j[-1] - rest))
    return log_energy_ratio / (4.0 * np.pi * frequency_hz * run.time_s[-1])


def energy_above_rest(run: Trajectory, beam: AncfBeam, modes: BeamModes) -> FloatArray:
    return run.energy_j - beam.elastic(modes.equilibrium).energy_j + beam.weight_load_n @ modes.equilibrium


def log_energy_slope(time_s: FloatArray, energy_j: FloatArray) -> float:
    """Damping rate 2 zeta omega from a linear fit to log energy, weighted to average over the phase of the cycle."""
    weight = np.hanning(time_s.size + 2)[1:-1]
    return -np.polyfit(time_s, np.log(energy_j), 1, w=np.sqrt(weight))[0]


def damping_over_a_decay(
    run: Trajectory, beam: AncfBeam, modes: BeamModes, window_s: float
) -> tuple[FloatArray, FloatArray]:
    """Squared amplitude relative to the start, and damping ratio of mode 1, in windows along a decay."""
    energy = energy_above_rest(run, beam, modes)
    size = int(np.searchsorted(run.time_s, window_s))
    weight = np.hanning(size + 2)[1:-1]
    parts = [slice(k, k + size) for k in range(0, energy.size - size, size // 4)]
    ratio = [log_energy_slope(run.time_s[p], energy[p]) / (2.0 * modes.omega_rad_s[0]) for p in parts]
    level = [np.exp(weight @ np.log(energy[p]) / weight.sum()) / energy[0] for p in parts]
    return np.array(level), np.array(ratio)


def dissipated_damping_ratio(
    beam: AncfBeam, modes: BeamModes, rayleigh: RayleighDamping, start: State
) -> float:
    """Damping ratio of mode 1 from the dissipation ``v.(alpha M + beta K(q)) v`` in undamped motion.

    Quadrature over states every 10.5 ms for 8 s, independent of the damping in the integrator. Relaxation suppresses
    axial waves, which are absent in the damped beam.
    """
    mass, state, power, energy = beam.mass_matrix(), start, [], []
    for _ in range(760):
        run = simulate(
            beam, NoDamping(), state=state, duration_s=10.5e-3, step_s=5e-4, output_positions_m=TIP, output_every=21,
            modes=modes, axial_relaxation_s=1e-4,
        )  # fmt: skip
        state = run.final
        damping = rayleigh.alpha_1_s * mass + rayleigh.beta_s * from_band(beam.elastic(state.q).tangent)
        power.append(state.v @ damping @ state.v)
        energy.append(energy_above_rest(run, beam, modes)[-1])
    weight = np.hanning(762)[1:-1]
    return weight @ np.array(power) / (weight @ np.array(energy)) / (2.0 * modes.omega_rad_s[0])


def elastica_tip(load: float) -> tuple[float, float]:
    """Tip displacement (w / L, u / L) of a cantilever under a dead transverse load, P L^2 / EI = `load`.

    Bisshopp and Drucker, "Large deflection of cantilever beams", Quart. Appl. Math. 3 (1945) 272-275.
    """
    root = np.sqrt(load)

    def start(modulus: float) -> float:
        return np.arcsin(1.0 / np.sqrt(2.0 * modulus))

    # m = (1 + sin(tip angle)) / 2 is the parameter of the elliptic integrals
    m = brentq(lambda x: ellipk(x) - ellipkinc(start(x), x) - root, 0.5 + 1e-9, 1.0 - 1e-12, xtol=1e-15)
    across = 1.0 - 2.0 / root * (ellipe(m) - ellipeinc(start(m), m))
    return across, 1.0 - np.sqrt(2.0 * (2.0 * m - 1.0)) / root

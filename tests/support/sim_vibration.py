"""Small decays and what they tell of frequency and damping; the elastica."""

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from sim.beam.ancf import from_band
from sim.damping import NoDamping
from sim.dynamics.excitation import state_from_modes
from sim.dynamics.simulate import simulate

TIP = np.array([0.5])


def small_decay(beam, modes, damping, number, step_s, duration_s=2.0):
    """Decay of one mode from a tip displacement of 10 um, where shape and frequency depend on amplitude by
    less than 1e-7."""
    coordinate = np.zeros(number)
    coordinate[-1] = 1e-5 / modes.transverse_at(TIP)[0, number - 1]
    state = state_from_modes(beam, modes, coordinate, np.zeros(number))
    return simulate(
        beam, damping, state=state, duration_s=duration_s, step_s=step_s, output_positions_m=TIP, modes=modes
    )


def damping_and_frequency_error(run, omega, zeta):
    """Relative errors of damping ratio and frequency, by linear least squares about the prescribed pole."""
    exponent = omega * complex(-zeta, np.sqrt(1.0 - zeta**2))
    decay = np.exp(exponent * run.time_s)
    columns = np.stack([decay.real, decay.imag, (run.time_s * decay).real, (run.time_s * decay).imag], axis=1)
    a, b, c, d = np.linalg.lstsq(columns, run.transverse_m[:, 0], rcond=None)[0]
    shift = complex(c, -d) / complex(a, -b)
    return (-shift.real / (zeta * omega) if zeta else -shift.real / omega), shift.imag / omega


def energy_damping_ratio(run, beam, modes, frequency_hz):
    rest = beam.elastic(modes.equilibrium).energy_j - beam.weight_load_n @ modes.equilibrium
    lost = np.log((run.energy_j[0] - rest) / (run.energy_j[-1] - rest))
    return lost / (4.0 * np.pi * frequency_hz * run.time_s[-1])


def energy_above_rest(run, beam, modes):
    return run.energy_j - beam.elastic(modes.equilibrium).energy_j + beam.weight_load_n @ modes.equilibrium


def log_energy_slope(time_s, energy_j):
    """Damping rate 2 zeta omega by a line through log energy, weighted so that no part of a cycle counts double."""
    weight = np.hanning(time_s.size + 2)[1:-1]
    return -np.polyfit(time_s, np.log(energy_j), 1, w=np.sqrt(weight))[0]


def damping_over_a_decay(run, beam, modes, window_s):
    """Square of the amplitude, relative to the start, and damping ratio of mode 1 in windows along a decay."""
    energy = energy_above_rest(run, beam, modes)
    size = int(np.searchsorted(run.time_s, window_s))
    weight = np.hanning(size + 2)[1:-1]
    parts = [slice(k, k + size) for k in range(0, energy.size - size, size // 4)]
    ratio = [log_energy_slope(run.time_s[p], energy[p]) / (2.0 * modes.omega_rad_s[0]) for p in parts]
    level = [np.exp(weight @ np.log(energy[p]) / weight.sum()) / energy[0] for p in parts]
    return np.array(level), np.array(ratio)


def dissipated_damping_ratio(beam, modes, rayleigh, start):
    """What Rayleigh damping takes from the undamped motion, ``v.(alpha M + beta K(q)) v``, as a ratio of mode 1.

    By quadrature of states 10.5 ms apart over 8 s, so that it owes nothing to how the integrator damps. Relaxation
    keeps axial waves, which the damped beam does not have, out of it.
    """
    mass, state, taken, energy = beam.mass_matrix(), start, [], []
    for _ in range(760):
        run = simulate(
            beam, NoDamping(), state=state, duration_s=10.5e-3, step_s=5e-4, output_positions_m=TIP, output_every=21,
            modes=modes, axial_relaxation_s=1e-4,
        )  # fmt: skip
        state = run.final
        damping = rayleigh.alpha_1_s * mass + rayleigh.beta_s * from_band(beam.elastic(state.q).tangent)
        taken.append(state.v @ damping @ state.v)
        energy.append(energy_above_rest(run, beam, modes)[-1])
    weight = np.hanning(762)[1:-1]
    return weight @ np.array(taken) / (weight @ np.array(energy)) / (2.0 * modes.omega_rad_s[0])


def elastica_tip(load):
    """Tip (w / L, u / L) of a cantilever under a dead transverse load, P L^2 / EI = `load`.

    Bisshopp and Drucker, "Large deflection of cantilever beams", Quart. Appl. Math. 3 (1945) 272-275.
    """
    root = np.sqrt(load)

    def start(modulus):
        return np.arcsin(1.0 / np.sqrt(2.0 * modulus))

    # m = (1 + sin(tip angle)) / 2 is the parameter of the elliptic integrals
    m = brentq(lambda x: ellipk(x) - ellipkinc(start(x), x) - root, 0.5 + 1e-9, 1.0 - 1e-12, xtol=1e-15)
    across = 1.0 - 2.0 / root * (ellipe(m) - ellipeinc(start(m), m))
    return across, 1.0 - np.sqrt(2.0 * (2.0 * m - 1.0)) / root

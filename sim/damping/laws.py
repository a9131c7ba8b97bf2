r"""The damping laws that come with the package.

Constant loss factor: complex stiffness ``K (1 + i eta)``, damping ratio eta / 2 at every frequency (Crandall, J. Sound
Vib. 11 (1970) 3, doi:10.1016/S0022-460X(70)80105-5). In time it is not causal, and would need a rational approximation;
none is needed here, since the simulation takes a damping ratio for each mode.

Kelvin-Voigt: :math:`\sigma = E (\varepsilon + \beta \dot\varepsilon)`, :math:`\zeta = \beta \omega / 2`; mass:
:math:`\zeta = \alpha / (2 \omega)`: the two terms of Eq. 3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from sim.damping.entry import BeamSection, DampingModelEntry, law_entry
from sim.damping.law import TUNING, ComputedLaw, ParametricLaw, PowerLaw, ThroughAllModes, normal_nodes
from sim.damping.models import DampingCoefficients, DampingModel, RayleighDamping
from tracker import FloatArray

if TYPE_CHECKING:
    from sim.beam import BeamModes
    from sim.damping.entry import MeasuredDamping

CONSTANT = law_entry(
    "constant",
    "constant loss factor",
    "Complex stiffness: all modes have the same damping ratio, half the loss factor.",
    ("#26734d", "#7ad6a8"),
    PowerLaw(0),
)


class Proportional(PowerLaw):
    """A damping ratio proportional to the frequency (power 1) or to its inverse (-1)."""

    def model(self, measured: MeasuredDamping, omega_rad_s: FloatArray) -> RayleighDamping:
        """Rayleigh damping with one coefficient, so that modes above the measured ones follow the law too."""
        top = omega_rad_s[-1:]
        coefficient = float((2.0 * self.damping_ratio(measured, top) / top**self.power)[0])
        return RayleighDamping(0.0, coefficient) if self.power > 0 else RayleighDamping(coefficient, 0.0)


KELVIN_VOIGT = law_entry(
    "kelvin_voigt",
    "Kelvin-Voigt damping",
    "β K(q): viscous material, damping ratio proportional to the frequency.",
    ("#9c3848", "#f0909f"),
    Proportional(1),
)
MASS = law_entry(
    "mass",
    "mass-proportional damping",
    "α M: damping ratio inversely proportional to the frequency.",
    ("#3f6f8f", "#8fc3e6"),
    Proportional(-1),
)


# Uniform prior; the step is a third of what a scatter of 1 % over a factor of 50 in frequency determines.
_EXPONENTS = np.linspace(-1.0, 1.0, 501)


class Fractional(ParametricLaw):
    """A damping ratio proportional to a power of the frequency, uniformly distributed from -1 to 1.

    Between mass-proportional (-1), hysteretic (0) and viscous (1) damping. In the fractional Kelvin-Voigt model ``sigma
    = E (e + tau^a D^a e)`` the loss factor grows as omega^a for small losses (Bagley, Torvik, J. Rheol. 27 (1983),
    doi:10.1122/1.549724).
    """

    shape_name = "exponent"

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Exponents."""
        return _EXPONENTS, np.full(_EXPONENTS.size, 1.0 / _EXPONENTS.size)

    def log_ratio(self, omega: FloatArray, reference: float, section: BeamSection | None) -> FloatArray:  # noqa: ARG002
        """Exponent times the logarithm of the frequency."""
        return np.outer(_EXPONENTS, np.log(omega / reference))


FRACTIONAL = law_entry(
    "fractional",
    "fractional damping",
    "Damping ratio proportional to a power of the frequency between -1 and 1.",
    ("#8a5a00", "#e0b060"),
    Fractional(),
)


def thermoelastic_ratio(omega: FloatArray, section: BeamSection) -> FloatArray:
    r"""Damping ratio at these angular frequencies by heat flow across the thickness; NaN without a material.

    .. math:: \zeta = \frac{\Delta}{2} \frac{\omega \tau}{1 + \omega^2 \tau^2}, \quad
              \Delta = \frac{E \alpha^2 T}{\rho c_p}, \quad \tau = \frac{h^2 \rho c_p}{\pi^2 k}

    No parameter is free. The single relaxation (Zener, Phys. Rev. 52 (1937) 230, doi:10.1103/PhysRev.52.230) is within
    1.5 % of the exact solution (Lifshitz, Roukes, Phys. Rev. B 61 (2000) 5600, doi:10.1103/PhysRevB.61.5600) up to
    omega tau = 5, 5 % low at 10, 14 % low at 100 (tests/sim/damping/test_laws.py).
    """
    material = section.material
    if material is None:
        return np.full_like(omega, np.nan)
    heat = section.density_kg_m3 * material.heat_capacity_j_kg_k
    relaxation = section.elastic_modulus_pa * material.expansion_1_k**2 * section.temperature_k / heat
    phase = omega * section.thickness_m**2 * heat / (np.pi**2 * material.conductivity_w_m_k)
    return np.asarray(0.5 * relaxation * phase / (1.0 + phase**2))


THERMOELASTIC = law_entry(
    "thermoelastic",
    "thermoelastic damping",
    "Heat flow across the thickness, computed from [beam] material without a free parameter (Zener).",
    ("#a03a78", "#ee94c6"),
    ComputedLaw(thermoelastic_ratio, needs_material=True),
)


# Sader's Eq. 21, real and imaginary: coefficients of powers of log10 Re, from the constant on
_ABOVE = (
    (0.91324, -0.48274, 0.46842, -0.12886, 0.044055, -0.0035117, 0.00069085),
    (-0.024134, -0.029256, 0.016294, -0.00010961, 0.000064577, -0.000044510, 0.0),
)
_BELOW = (
    (1.0, -0.56964, 0.48690, -0.13444, 0.045155, -0.0035862, 0.00069085),
    (1.0, -0.59702, 0.55182, -0.18357, 0.079156, -0.014369, 0.0028361),
)


def viscous_air_ratio(omega: FloatArray, section: BeamSection) -> FloatArray:
    r"""Damping ratio of a thin blade at these angular frequencies by still air at small amplitude.

    .. math:: \zeta = \frac{t \Gamma_i}{2 (1 + t \Gamma_r)}, \quad t = \frac{\pi \rho_{air} b}{4 \rho h}, \quad
              \mathrm{Re} = \frac{\rho_{air} \omega b^2}{4 \mu}

    :math:`\Gamma` is that of a cylinder, corrected for the section of a blade (Sader, J. Appl. Phys. 84 (1998) 64,
    doi:10.1063/1.368002, Eq. 20 and 21: within 0.1 % for Re from 1e-6 to 1e4). The flow is two-dimensional and
    attached: a motion that is not small against the width is damped more (`StillAir`), and so is a beam beside a wall.
    """
    from scipy.special import kve  # noqa: PLC0415 - a run that is up to date loads none of SciPy

    air, width = section.air_density_kg_m3, section.width_m
    reynolds = air * omega * width**2 / (4.0 * section.air_viscosity_pa_s)
    root = np.sqrt(1j * reynolds)
    powers = np.log10(reynolds) ** np.arange(7)[:, np.newaxis]
    blade = np.array([1.0, 1.0j]) @ ((_ABOVE @ powers) / (_BELOW @ powers))
    gamma = (1.0 + 4.0j * kve(1, -1j * root) / (root * kve(0, -1j * root))) * blade
    ratio = 0.25 * np.pi * air * width / (section.density_kg_m3 * section.thickness_m)
    return np.asarray(0.5 * ratio * gamma.imag / (1.0 + ratio * gamma.real))


_TEXT = (
    "Viscosity of still air at small amplitude, computed from the section without a free parameter (Sader)."
)
_LAW = ComputedLaw(viscous_air_ratio, needs_material=False)
VISCOUS_AIR = law_entry("viscous_air", "viscous air damping", _TEXT, ("#4b6bd0", "#a9bcff"), _LAW)


def caughey_weights(known: FloatArray, omega: FloatArray) -> FloatArray:
    """Weight of each known damping ratio in that at `omega`, shape (m, n): Lagrange's form of the series."""
    pairs = [(one**2, np.delete(known, k) ** 2) for k, one in enumerate(known)]
    columns = [np.prod((omega[:, np.newaxis] ** 2 - rest) / (one - rest), axis=1) for one, rest in pairs]
    return np.stack(columns, axis=1) * np.divide.outer(1.0 / omega, 1.0 / known)


@dataclass(frozen=True)
class CaugheyDamping(DampingModel):
    r"""Damping ratios of modes 1 to m by Caughey's series; above, where it is unbounded, that of mode m.

    :math:`2 \zeta \omega = \sum_j a_j \omega^{2j}`, j = 0 to n - 1 (Caughey, J. Appl. Mech. 27 (1960) 269,
    doi:10.1115/1.3643949).
    """

    damping_ratio: tuple[float, ...]

    @property
    def caution(self) -> str:
        """Warning about a negative damping ratio."""
        return (
            "Caughey's series is negative at a mode: it adds energy." if min(self.damping_ratio) < 0.0 else ""
        )

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """Modal ratios."""
        ratio = np.pad(self.damping_ratio, (0, modes.count), mode="edge")
        return DampingCoefficients(0.0, 0.0, 0.0, ratio[: modes.count])


class Caughey(ThroughAllModes):
    """The series."""

    def model(self, measured: MeasuredDamping, omega_rad_s: FloatArray) -> CaugheyDamping:
        """Damping ratios by the series through the beam's own frequencies: it would magnify their errors."""
        at = np.array(measured.numbers) - 1
        own = replace(measured, frequency_hz=tuple(omega_rad_s[at] / (2.0 * np.pi)))
        return CaugheyDamping(tuple(map(float, self.damping_ratio(own, omega_rad_s))))


_SHOWN = "Caughey damping", "Caughey's series with one term for each measured mode.", ("#6b7a1c", "#c4d468")
CAUGHEY = law_entry("caughey", *_SHOWN, Caughey(caughey_weights))


class SumOfLaws(ParametricLaw):
    r"""Sum of two laws without a parameter beside the level; a computed one is the second.

    Two levels: their ratio at the reference has the prior :math:`\ln r \sim N(0, (\ln 10)^2)`, their sum that of a
    level. With a computed law, which is not fitted, the level has its own prior.
    """

    def __init__(self, *entries: DampingModelEntry) -> None:
        first, second = (entry.law for entry in entries)
        if not (isinstance(first, ParametricLaw) and isinstance(second, ParametricLaw)):
            msg = f"expected two laws of a level, got {[entry.key for entry in entries]}"
            raise TypeError(msg)
        self._laws, self.free_level = (first, second), second.free_level
        self.shape_name = "log ratio" if self.free_level else "log level" if first.free_level else ""

    def lacks(self, section: BeamSection | None) -> str:
        """Of either."""
        return self._laws[0].lacks(section) or self._laws[1].lacks(section)

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Logarithm of the ratio of the levels, second over first, or of the level of the first."""
        if not self.shape_name:
            return super().nodes()
        level = np.log(TUNING.level), TUNING.level_sd
        return normal_nodes(*((0.0, np.log(10.0)) if self.free_level else level))

    def log_ratio(self, omega: FloatArray, reference: float, section: BeamSection | None) -> FloatArray:
        """Sum at each node; of two levels, relative to their sum at the reference."""
        first, second = (law.log_ratio(omega, reference, section) for law in self._laws)
        node = self.nodes()[0][:, np.newaxis]
        if self.free_level:
            return np.asarray(np.logaddexp(first, node + second) - np.logaddexp(0.0, node))
        return np.asarray(np.logaddexp(first + node, second))


def _sum(first: DampingModelEntry, second: DampingModelEntry, at: int) -> DampingModelEntry:
    name = f"{first.name} and {second.name}"
    colours = (f"#{90 + 7 * at:02x}5a{154 - 9 * at:02x}", f"#{176 + 6 * at:02x}c4{240 - 9 * at:02x}")
    key, law = f"{first.key}_and_{second.key}", SumOfLaws(first, second)
    return law_entry(key, name, f"Sum of {name}.", colours, law, draw_stride=8)


_PARTS = (MASS, CONSTANT, KELVIN_VOIGT, VISCOUS_AIR, THERMOELASTIC)
_PAIRS = (pair for pair in combinations(_PARTS, 2) if pair != (MASS, KELVIN_VOIGT))
SUMS = tuple(_sum(*pair, at) for at, pair in enumerate(_PAIRS))
MASS_AND_STIFFNESS = SumOfLaws(MASS, KELVIN_VOIGT)  # the law of Rayleigh's entry

r"""Damping models: forces that oppose the motion.

The linear models act on velocities relative to the base, so a rigid translation of the whole experiment is not damped.
Quadratic air drag acts on the velocity relative to still air, which includes the motion of the base.

References
----------
Yoo, Lee, Kim, "Tracking for high-order damping of thin beam oscillation", Eq. 3 to 6. Eq. 6 is misprinted; the inverse
of Eq. 5 is C_g = Phi^-T C_r Phi^-1 = M Phi diag(2 zeta_r omega_r) Phi^T M for mass-normalised modes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tracker import FloatArray, checked

if TYPE_CHECKING:
    # the configuration reads the registry, and the beam's kernels are slow to load
    from sim.beam import BeamModes


@dataclass(frozen=True)
class StillAir:
    """Air at rest around the beam, with the drag ``rho c_d b / 2 |v_n| v_n`` per length along the beam's normal.

    v_n is the normal component of the velocity, b the width of the element. A single mode of amplitude A (m kg^1/2, phi
    mass-normalised) then has the damping ratio ``2 / (3 pi) rho c_d A int b |phi|^3 dx``.

    Attributes
    ----------
    density_kg_m3 : float
        1.204 at 20 degrees Celsius and 1013 hPa.
    drag_coefficient : float
        2 for a long flat plate across a steady stream; several times that for small vibrations.
    """

    density_kg_m3: float = 1.204
    drag_coefficient: float = 2.0

    def __post_init__(self) -> None:
        for name in ("density_kg_m3", "drag_coefficient"):
            checked(name, getattr(self, name), at_least=0.0)


@dataclass(frozen=True)
class DampingCoefficients:
    """Damping force ``(mass M + current K(q) + constant K(q_eq)) v``, and the damping ratio prescribed to each mode.

    For each mode the integrator adds a modal term ``M phi d phi^T M v`` so that the mode's total damping ratio at small
    amplitude is the prescribed one.

    Attributes
    ----------
    mass_1_s : float
        alpha of Eq. 3.
    stiffness_s, constant_stiffness_s : float
        beta of Eq. 3 on the current tangent stiffness, the rate of the elastic force, and on that at the equilibrium.
    damping_ratio : array, shape (m,)
    """

    mass_1_s: float
    stiffness_s: float
    constant_stiffness_s: float
    damping_ratio: FloatArray
    air: StillAir | None = None


class DampingModel(ABC):
    """How a beam dissipates energy."""

    @abstractmethod
    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """Coefficients for a beam with these modes."""

    @property
    def least_beam_modes(self) -> int:
        """Number of beam modes that `coefficients` needs."""
        return 1

    @property
    def caution(self) -> str:
        """Why a simulation with these parameters may diverge; empty when nothing is unusual."""
        return ""


@dataclass(frozen=True)
class NoDamping(DampingModel):
    """No dissipation."""

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """All zero."""
        return DampingCoefficients(0.0, 0.0, 0.0, np.zeros(modes.count))


@dataclass(frozen=True)
class RayleighDamping(DampingModel):
    """Eq. 3: ``C = alpha M + beta K``, the paper's linear damping model.

    ``K`` is the current tangent stiffness K(q), in rate form: beta times the rate of the elastic force. The constant
    stiffness of the undeformed beam (`constant_stiffness`) also damps the axial motion that accompanies large
    rotation, and overestimates the damping of large vibrations several times; it is provided to show this effect.

    Attributes
    ----------
    alpha_1_s, beta_s : float
    constant_stiffness : bool

    Examples
    --------
    Through 1 % at 10 rad/s and 2 % at 100 rad/s:

    >>> model = RayleighDamping.from_modes((10.0, 100.0), (0.01, 0.02))
    >>> model.damping_ratio([10.0, 100.0, 1000.0]).round(4).tolist()
    [0.01, 0.02, 0.192]
    """

    alpha_1_s: float
    beta_s: float
    constant_stiffness: bool = False

    @classmethod
    def from_modes(
        cls,
        omega_rad_s: tuple[float, float],
        damping_ratio: tuple[float, float],
        *,
        constant_stiffness: bool = False,
    ) -> RayleighDamping:
        """Eq. 4: the coefficients that give two modes their damping ratios.

        Raises
        ------
        ValueError
            If the two frequencies are not positive and different.
        """
        (w1, w2), (z1, z2) = omega_rad_s, damping_ratio
        if not (w1 > 0.0 and w2 > 0.0 and w1 != w2):
            msg = f"Rayleigh damping needs two different positive frequencies, got {w1} and {w2} rad/s"
            raise ValueError(msg)
        difference = w2**2 - w1**2
        return cls(
            alpha_1_s=2.0 * w1 * w2 * (z1 * w2 - z2 * w1) / difference,
            beta_s=2.0 * (z2 * w2 - z1 * w1) / difference,
            constant_stiffness=constant_stiffness,
        )

    @property
    def caution(self) -> str:
        """Warning about a negative beta."""
        if self.beta_s >= 0.0:
            return ""
        return (
            f"Its beta is negative ({self.beta_s:.3g} s) because the damping ratio of the lower mode is much larger: "
            "it adds energy to the higher modes instead of damping them."
        )

    def damping_ratio(self, omega_rad_s: FloatArray) -> FloatArray:
        """Damping ratio of a mode of this frequency: ``alpha / (2 omega) + beta omega / 2``."""
        omega = np.asarray(omega_rad_s, dtype=np.float64)
        return 0.5 * (self.alpha_1_s / omega + self.beta_s * omega)

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """Alpha and beta, from which the damping ratio of every mode follows."""
        current = 0.0 if self.constant_stiffness else self.beta_s
        constant = self.beta_s if self.constant_stiffness else 0.0
        return DampingCoefficients(self.alpha_1_s, current, constant, self.damping_ratio(modes.omega_rad_s))


@dataclass(frozen=True)
class GenericDamping(DampingModel):
    """Eq. 5 and 6: each measured mode has its own damping ratio, ``C_g = M Phi diag(2 zeta omega) Phi^T M``.

    Eq. 6 leaves every mode above the highest measured one undamped, so any motion in those modes would persist. They
    receive a residual damping instead, proportional to the current stiffness K(q): `residual_ratio` at the first mode
    above, increasing in proportion to frequency from there. The measured modes keep exactly their ratios.

    Attributes
    ----------
    damping_ratio : tuple of float
        Of modes 1 to m.
    residual_ratio : float or None
        Damping ratio of mode m + 1. None, the default, uses that of mode m; 0 is Eq. 6 unchanged.

    Examples
    --------
    >>> from sim.beam.beam import Beam, natural_modes
    >>> beam = Beam(length_mm=500, width_mm=5, thickness_mm=0.5, density_kg_m3=8000, elastic_modulus_mpa=210e3)
    >>> model = GenericDamping((0.010, 0.0028, 0.0028))
    >>> model.coefficients(natural_modes(beam, 4)).damping_ratio.round(4).tolist()
    [0.01, 0.0028, 0.0028, 0.0028]
    """

    damping_ratio: tuple[float, ...]
    residual_ratio: float | None = None

    def __post_init__(self) -> None:
        ratios = (*self.damping_ratio, 0.0 if self.residual_ratio is None else self.residual_ratio)
        if not self.damping_ratio or not all(0.0 <= ratio < 1.0 for ratio in ratios):
            msg = f"expected one damping ratio between 0 and 1 per mode, from the first mode on; got {ratios}"
            raise ValueError(msg)

    @property
    def least_beam_modes(self) -> int:
        """One more than the measured modes, for the residual damping."""
        return len(self.damping_ratio) + 1

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """Modal ratios and the residual for these modes.

        Raises
        ------
        ValueError
            If there is no mode above the measured ones for the residual.
        """
        measured = len(self.damping_ratio)
        residual = self.damping_ratio[-1] if self.residual_ratio is None else self.residual_ratio
        if modes.count <= measured:
            msg = (
                f"generic damping of {measured} modes needs at least {measured + 1} modes of the beam, "
                f"got {modes.count}: request more from beam_modes"
            )
            raise ValueError(msg)
        beta = 2.0 * residual / float(modes.omega_rad_s[measured])
        ratios = 0.5 * beta * modes.omega_rad_s
        ratios[:measured] = self.damping_ratio
        return DampingCoefficients(0.0, beta, 0.0, ratios)


@dataclass(frozen=True)
class WithAirDrag(DampingModel):
    """Another damping model together with the quadratic drag of still air.

    The damping ratios of the other model are those in the limit of small amplitude, where the drag vanishes.
    """

    model: DampingModel
    air: StillAir = StillAir()

    @property
    def least_beam_modes(self) -> int:
        """That of the other model."""
        return self.model.least_beam_modes

    @property
    def caution(self) -> str:
        """That of the other model."""
        return self.model.caution

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """Those of the other model, with the air."""
        return replace(self.model.coefficients(modes), air=self.air)

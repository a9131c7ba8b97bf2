r"""Damping models: what resists the motion.

The linear models act on velocities relative to the base by default, so that a rigid translation of the whole
experiment is not damped; with ``velocity="absolute"`` they act on velocities against the room, as friction in the
surrounding air would. Between the two the steady amplitude at a resonance differs by 2 zeta^2 and its phase by
2 zeta. Quadratic air drag acts on the velocity against still air, the base's motion included.

References
----------
Yoo, Lee, Kim, "Tracking for high-order damping of thin beam oscillation", Eq. 3 to 6. Eq. 6 as printed is garbled; the
inverse of Eq. 5 is C_g = Phi^-T C_r Phi^-1 = M Phi diag(2 zeta_r omega_r) Phi^T M for mass-normalised modes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from sim.beam.modes import BeamModes
from tracker.arrays import FloatArray

Velocity = Literal["relative", "absolute"]


@dataclass(frozen=True)
class StillAir:
    """Air at rest about the beam, resisting with ``rho c_d b / 2 |v_n| v_n`` per length along the beam's normal.

    v_n is the normal component of the velocity, b the width of the element. One mode of amplitude A (m kg^1/2, phi
    mass-normalised) then has the damping ratio ``2 / (3 pi) rho c_d A int b |phi|^3 dx``.

    Attributes
    ----------
    density_kg_m3 : float
        1.204 at 20 degrees Celsius and 1013 hPa.
    drag_coefficient : float
        2 for a long flat plate across a steady stream; small vibrations see several times that.
    """

    density_kg_m3: float = 1.204
    drag_coefficient: float = 2.0

    def __post_init__(self) -> None:
        for name in ("density_kg_m3", "drag_coefficient"):
            value = getattr(self, name)
            if not 0.0 <= value < float("inf"):
                msg = f"{name} must be finite and not negative, got {value}"
                raise ValueError(msg)


@dataclass(frozen=True)
class DampingCoefficients:
    """Damping force ``(mass M + current K(q) + constant K(q_eq)) v``, and what each mode's damping ratio shall be.

    The integrator adds a modal term ``M phi d phi^T M v`` for each of the modes so that, together with the rest,
    its damping ratio at small amplitude is the one prescribed.

    Attributes
    ----------
    mass_1_s : float
        alpha of Eq. 3.
    stiffness_s : float
        beta of Eq. 3 on the current tangent stiffness: the rate of the elastic force.
    constant_stiffness_s : float
        The same on the stiffness at the equilibrium.
    damping_ratio : array, shape (m,)
        Of each of the modes given.
    velocity : {"relative", "absolute"}
        To the base, or to the room.
    air : StillAir or None
    modal_count : int
        Modes, from the first on, whose damping is a matter of their own; what is proportional to stiffness feels no
        translation of the whole beam.
    """

    mass_1_s: float
    stiffness_s: float
    constant_stiffness_s: float
    damping_ratio: FloatArray
    velocity: Velocity = "relative"
    air: StillAir | None = None
    modal_count: int = 0


class DampingModel(Protocol):
    """How a beam loses energy."""

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """Coefficients for a beam with these modes."""
        ...


@dataclass(frozen=True)
class NoDamping:
    """A beam that keeps its energy."""

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """All zero."""
        return DampingCoefficients(0.0, 0.0, 0.0, np.zeros(modes.count))


@dataclass(frozen=True)
class RayleighDamping:
    """Eq. 3: ``C = alpha M + beta K``, the paper's linear damping model.

    ``K`` is the current tangent stiffness K(q), in rate form: beta times the rate of the elastic force. A constant
    stiffness of the undeformed beam (`constant_stiffness`) damps the axial motion that large rotation brings with it
    and exaggerates the damping of large swings many times over; it is there to show just that.

    Attributes
    ----------
    alpha_1_s, beta_s : float
    constant_stiffness : bool
    velocity : {"relative", "absolute"}
        Which velocity alpha acts on; beta acts on the rate of strain, which knows no base.
    """

    alpha_1_s: float
    beta_s: float
    constant_stiffness: bool = False
    velocity: Velocity = "relative"

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

    def damping_ratio(self, omega_rad_s: FloatArray) -> FloatArray:
        """Damping ratio that the model gives a mode: ``alpha / (2 omega) + beta omega / 2``."""
        omega = np.asarray(omega_rad_s, dtype=np.float64)
        return 0.5 * (self.alpha_1_s / omega + self.beta_s * omega)

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """As they are; every mode's ratio follows from them."""
        current = 0.0 if self.constant_stiffness else self.beta_s
        constant = self.beta_s if self.constant_stiffness else 0.0
        return DampingCoefficients(
            self.alpha_1_s, current, constant, self.damping_ratio(modes.omega_rad_s), self.velocity
        )


@dataclass(frozen=True)
class GenericDamping:
    """Eq. 5 and 6: each measured mode has its own damping ratio, ``C_g = M Phi diag(2 zeta omega) Phi^T M``.

    Eq. 6 leaves every mode above the last measured one undamped: what rings there after a stop would ring for ever.
    The modes above get a stated residual instead, proportional to the current stiffness K(q): `residual_ratio` at the
    first mode above and rising in proportion to frequency from there. The measured modes keep their ratios exactly.

    Attributes
    ----------
    damping_ratio : tuple of float
        Of modes 1 to m.
    residual_ratio : float or None
        Damping ratio of mode m + 1. None, the default, takes that of mode m; 0 is Eq. 6 as it stands.
    velocity : {"relative", "absolute"}
        Which velocity C_g acts on.
    """

    damping_ratio: tuple[float, ...]
    residual_ratio: float | None = None
    velocity: Velocity = "relative"

    def __post_init__(self) -> None:
        ratios = (*self.damping_ratio, 0.0 if self.residual_ratio is None else self.residual_ratio)
        if not self.damping_ratio or not all(0.0 <= ratio < 1.0 for ratio in ratios):
            msg = f"damping ratios must lie between 0 and 1, one a mode from the first on; got {ratios}"
            raise ValueError(msg)

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """Modal ratios and the residual for these modes.

        Raises
        ------
        ValueError
            If there is no mode above the measured ones to place the residual at.
        """
        measured = len(self.damping_ratio)
        residual = self.damping_ratio[-1] if self.residual_ratio is None else self.residual_ratio
        if modes.count <= measured:
            msg = (
                f"generic damping of {measured} modes needs at least {measured + 1} modes of the beam, "
                f"got {modes.count}: ask beam_modes for more"
            )
            raise ValueError(msg)
        beta = 2.0 * residual / float(modes.omega_rad_s[measured])
        ratios = 0.5 * beta * modes.omega_rad_s
        ratios[:measured] = self.damping_ratio
        return DampingCoefficients(0.0, beta, 0.0, ratios, self.velocity, modal_count=measured)


@dataclass(frozen=True)
class WithAirDrag:
    """Another damping model, and quadratic drag of still air beside it.

    The other model's damping ratios are those of the limit of small amplitude, where the drag vanishes.

    Attributes
    ----------
    model : DampingModel
    air : StillAir
    """

    model: DampingModel
    air: StillAir = StillAir()

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """The other model's, with the air."""
        return replace(self.model.coefficients(modes), air=self.air)

r"""Time integration of the beam: energy-momentum midpoint rule, exact for the lowest modes.

One step solves, with u = q1 - q0, v1 = 2 u / h - v0,

.. math::  M (v_1 - v_0)/h + C u/h + f(q_0, q_1) = F - M r \ddot b ,

where f uses the mean of the axial strains at both ends of the step (Simo and Tarnow), so that without damping the
energy is constant to round-off at any amplitude. The low-rank `modal_terms` remove the period
error of the midpoint rule, 0.7 % for the paper's fifth mode at 0.5 ms.

References
----------
Simo, Tarnow, "The discrete energy-momentum method", ZAMP 43 (1992) 757-792, doi:10.1007/BF00913408.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sim.beam import AncfBeam, BeamModes, beam_modes, decoupled, diagonals, lower_columns, shape_functions
from sim.damping import DampingCoefficients, DampingModel, StillAir
from sim.dynamics.forces import Air, Axial
from sim.dynamics.march import DONE, Forcing, Structure, march, memory_for
from sim.dynamics.newton import STEP
from tracker import ComplexArray, Failure, FloatArray, checked, data_frame

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class State:
    """Displacement and velocity of the free coordinates relative to the clamp, each of shape (ndof,)."""

    q: FloatArray
    v: FloatArray


@dataclass(frozen=True)
class BaseMotion:
    """Transverse motion of the clamp, sampled at every step of a simulation.

    Attributes
    ----------
    displacement_m, velocity_m_s : array, shape (steps + 1,)
        The mean acceleration over a step is the difference of the velocities.
    """

    displacement_m: FloatArray
    velocity_m_s: FloatArray

    def __post_init__(self) -> None:
        if self.displacement_m.ndim != 1 or self.displacement_m.shape != self.velocity_m_s.shape:
            msg = (
                "displacement_m and velocity_m_s need one value per step each, got shapes "
                f"{self.displacement_m.shape} and {self.velocity_m_s.shape}"
            )
            raise ValueError(msg)
        if not (np.all(np.isfinite(self.displacement_m)) and np.all(np.isfinite(self.velocity_m_s))):
            msg = "a base motion must be finite at every step"
            raise ValueError(msg)

    @classmethod
    def sample(
        cls, motion: Callable[[FloatArray], tuple[FloatArray, FloatArray]], step_s: float, steps: int
    ) -> BaseMotion:
        """Evaluate ``motion(time_s) -> (displacement_m, velocity_m_s)`` on the grid of `steps` steps."""
        displacement, velocity = motion(np.arange(steps + 1, dtype=np.float64) * step_s)
        return cls(displacement, velocity)


@dataclass(frozen=True)
class SolverCounts:
    """Work of the integrator."""

    steps: int
    iterations: int
    factorisations: int
    halvings: int


@dataclass(frozen=True)
class Trajectory:
    """Motion of n instants, from 0, of k material points of a simulated beam.

    Attributes
    ----------
    positions_m : array, shape (k,)
        Distances of the points from the clamp along the undeformed beam.
    x_m, y_m, angle_rad : array, shape (n, k)
        In the image, right and up, with the clamp at rest at the origin and the motion of the base included; rotation
        from the undeformed direction, counter-clockwise.
    axial_m, transverse_m : array, shape (n, k)
        Displacement along the undeformed beam and across it, relative to the clamp.
    base_m, energy_j : array, shape (n,)
        Transverse displacement of the clamp; kinetic (relative to the clamp), strain and gravitational energy.
    """

    time_s: FloatArray
    positions_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    angle_rad: FloatArray
    axial_m: FloatArray
    transverse_m: FloatArray
    base_m: FloatArray
    energy_j: FloatArray
    final: State
    counts: SolverCounts

    def to_dataframe(self) -> pd.DataFrame:
        """One row per time and point: ``time_s, position_mm, x_mm, y_mm, angle_rad, transverse_mm``."""
        n, k = self.x_m.shape
        values = {
            "time_s": np.repeat(self.time_s, k),
            "position_mm": np.tile(1e3 * self.positions_m, n),
            "x_mm": 1e3 * self.x_m.ravel(),
            "y_mm": 1e3 * self.y_m.ravel(),
            "angle_rad": self.angle_rad.ravel(),
            "transverse_mm": 1e3 * self.transverse_m.ravel(),
        }
        return data_frame(values, {name: name.rpartition("_")[2] for name in values})

    def plot(self, ax: Any = None) -> Any:
        """Transverse displacement of each point against time; returns the matplotlib Axes."""
        import matplotlib.pyplot as plt  # noqa: PLC0415

        ax = plt.figure().add_subplot() if ax is None else ax
        for position_m, moved_m in zip(self.positions_m, self.transverse_m.T, strict=True):
            ax.plot(self.time_s, 1e3 * moved_m, linewidth=0.8, label=f"{1e3 * position_m:g} mm")
        ax.set(xlabel="time (s)", ylabel="transverse displacement (mm)")
        ax.legend(title="from the clamp")
        return ax

    def __repr__(self) -> str:
        return (
            f"Trajectory({self.positions_m.size} points, {self.time_s.size} times to {self.time_s[-1]:.4g} s)"
        )

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(index=False, max_rows=10))


@dataclass(frozen=True, kw_only=True)
class FailedSimulation(Failure):
    """A simulation that did not reach its end: the time and the step at which it stopped."""

    time_s: float = 0.0
    step: int = 0


@dataclass(frozen=True)
class Tuning:
    """Steps of a simulation, the accuracy to which they are solved, and the modes that are corrected."""

    #: [s] longest time step where the caller names none
    #: measurement: docs/studies/verification.md: the tip changes by 4e-8 of the amplitude from 1 to 0.5 ms; frequencies
    #: are within 1e-7.
    longest_step_s: float = 5e-4
    #: [rad] omega h per step of the highest mode of interest
    #: physics: Cubic splines between the steps are exact to (omega h)^4 / 384 = 4e-5 of that mode.
    largest_phase: float = 0.35
    #: [1] modes whose discrete frequency and damping are exact, where no more are asked for
    #: convention: The paper's five modes, and three above them for the residual damping and for what the start excites.
    fitted_modes: int = 8
    #: [1] levels of step halving, the full step included, before a simulation fails
    #: convention: Down to 1/32 of a step; chosen.
    halving_levels: int = 6
    #: [1] error of a step's iteration over the largest displacement of the preceding steps
    #: measurement: docs/studies/verification.md: the energy drifts by 2e-9 in 60 s from 200 mm.
    tolerance: float = 5e-12
    #: [lengths] error of a step's iteration below which a beam almost at rest is not solved further
    #: physics: A hundred times the rounding of a displacement of one length.
    smallest_tolerance: float = 1e-14
    #: [1] Gauss points of an element for the drag, whose |v| v is no polynomial
    #: convention: Chosen; exact for the drag of a rigid rotation, whose v^2 is quadratic along the beam.
    drag_points: int = 3
    #: [rad] omega h of a step above which a mode is not corrected
    #: physics: The midpoint rule is off by (omega h)^2 / 12 = 12 % there, and higher modes are not resolved.
    largest_corrected_phase: float = 1.2
    #: [1] share of a modal term in the mass part of the tangent below which it is omitted there
    #: physics: An iteration with an approximate tangent converges by about this factor; the solution does not depend on
    #: it.
    smallest_share: float = 0.01


TUNING = Tuning()


@dataclass(frozen=True)
class ModalTerms:
    """Low-rank corrections: rows of U^T, shape (r, ndof); mass and damping for each halving level, (levels, r)."""

    rows: FloatArray
    mass: FloatArray
    damping: FloatArray
    base_force: FloatArray
    phi: FloatArray
    equilibrium: FloatArray
    exponent: ComplexArray
    discrete: ComplexArray

    def discrete_velocity(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Velocity of the scheme that corresponds to the true velocity `v`.

        For a mode, the former is s^ times its displacement, the latter s times.
        """
        return v + self.phi @ (self._exchanged(q, v, self.exponent, self.discrete) - self.rows @ v)

    def true_velocity(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Inverse of `discrete_velocity`."""
        return v + self.phi @ (self._exchanged(q, v, self.discrete, self.exponent) - self.rows @ v)

    def _exchanged(
        self, q: FloatArray, v: FloatArray, given: ComplexArray, wanted: ComplexArray
    ) -> FloatArray:
        """Modal velocities Re(wanted c) of the motion with displacement Re(c) and velocity Re(given c)."""
        displacement, velocity = self.rows @ (q - self.equilibrium), self.rows @ v
        imaginary = (given.real * displacement - velocity) / given.imag
        return np.asarray(wanted.real * displacement - wanted.imag * imaginary)


def modal_terms(
    modes: BeamModes,
    coefficients: DampingCoefficients,
    levels_s: FloatArray,
    target_omega_rad_s: FloatArray | None,
) -> ModalTerms:
    r"""Low-rank terms that make a time step exact for the lowest modes, at each step size.

    With s = -zeta omega + i omega sqrt(1 - zeta^2) and s^ = (2 / h) tanh(s h / 2), terms ``U diag(mu) U^T`` of mass and
    ``U diag(d) U^T`` of damping, U = M Phi,

    .. math::  1 + \mu = \omega^2 / |\hat s|^2, \qquad d = -2 (1 + \mu)\,\mathrm{Re}\,\hat s ,

    multiply a small vibration of a mode by exactly e^{s h} in one step. They vanish as h^2. mu acts on the absolute
    acceleration, with the base's share scaled so that the response at resonance is exact too; d acts on the velocity
    relative to the base.
    """
    omega = modes.omega_rad_s
    target = omega.copy()
    if target_omega_rad_s is not None:
        target[: target_omega_rad_s.size] = target_omega_rad_s
    fitted = omega * levels_s[0] < TUNING.largest_corrected_phase
    omega, target, zeta = omega[fitted], target[fitted], coefficients.damping_ratio[fitted]
    rows = np.ascontiguousarray((modes.beam.mass_matrix() @ modes.phi[:, fitted]).T)
    exponent = target * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    h = levels_s[:, np.newaxis]
    discrete = 2.0 / h * np.tanh(0.5 * exponent * h)
    ratio = omega**2 / np.abs(discrete) ** 2
    elsewhere = (
        coefficients.mass_1_s + (coefficients.stiffness_s + coefficients.constant_stiffness_s) * omega**2
    )
    phase = 0.5 * target * levels_s[0]
    # with x = omega h / 2, the difference of the base's velocity over a step is the mean acceleration times sin(x) / x,
    # and at resonance the corrected damping acts on a velocity that is smaller by the same factor
    share = (omega / target) ** 2 * (phase / np.sin(phase)) ** 2 - 1.0
    base_force = modes.beam.base_coupling_kg + rows.T @ (share * modes.base_participation()[fitted])
    return ModalTerms(
        rows=rows,
        mass=ratio - 1.0,
        damping=-2.0 * ratio * discrete.real - elsewhere,
        base_force=base_force,
        phi=np.ascontiguousarray(modes.phi[:, fitted]),
        equilibrium=modes.equilibrium,
        exponent=exponent,
        discrete=discrete[0],
    )


def first_that_matters(gain: FloatArray, step_s: FloatArray) -> NDArray[np.int64]:
    """First of the modal terms, (..., r), with a significant share of the tangent's mass part; r where none has."""
    share = np.abs(gain) * step_s[..., np.newaxis] ** 2 > 2.0 * TUNING.smallest_share
    return np.asarray(np.where(np.any(share, axis=-1), np.argmax(share, axis=-1), share.shape[-1]))


def simulate(
    beam: AncfBeam,
    damping: DampingModel,
    *,
    state: State,
    duration_s: float,
    step_s: float,
    output_positions_m: FloatArray,
    base: BaseMotion | None = None,
    output_every: int = 1,
    modes: BeamModes | None = None,
    target_omega_rad_s: FloatArray | None = None,
    axial_relaxation_s: float = 0.0,
) -> Trajectory | FailedSimulation:
    """Integrate the motion of the beam from `state`.

    Parameters
    ----------
    duration_s, step_s : float
        The duration is rounded to whole steps.
    output_positions_m : array, shape (k,)
        Distances of the points from the clamp; motion is stored every `output_every` steps.
    base : BaseMotion, optional
        Motion of the clamp, with steps + 1 samples; at rest when absent.
    modes : BeamModes, optional
        Modes whose discrete frequency and damping are exact; the first eight when absent.
    target_omega_rad_s : array, shape (m,), optional
        Angular frequencies prescribed to the first m modes; the difference to the model's own enters as modal mass.
    axial_relaxation_s : float
        Kelvin-Voigt damping of the axial strain: viscosity over EA. 1e-4 s damps axial waves that the step does not
        resolve and has a negligible effect on bending; 0 leaves them undamped.

    Returns
    -------
    Trajectory or FailedSimulation
        The latter when a step does not converge even with halvings to ``step / 32``.

    Raises
    ------
    ValueError
        If durations, base motion and state do not match.
    """
    steps = checked_steps(beam, state, duration_s, step_s, output_every, base)
    if modes is None:
        modes = beam_modes(beam, min(TUNING.fitted_modes, beam.properties.elements))
    coefficients = damping.coefficients(modes)
    levels_s = np.array([step_s / 2**level for level in range(TUNING.halving_levels)])
    terms = modal_terms(modes, coefficients, levels_s, target_omega_rad_s)
    rows = steps // output_every + 1
    out_q, energy = np.empty((rows, beam.ndof)), np.empty(rows)
    info = np.zeros(4, dtype=np.int64)
    q = np.array(state.q, dtype=np.float64)
    v = terms.discrete_velocity(q, np.asarray(state.v, dtype=np.float64))
    structure = _structure(beam, modes, coefficients, levels_s, terms, axial_relaxation_s)
    code = march(
        (steps, output_every),
        step_s,
        q,
        v,
        structure,
        _forcing(beam, terms, base, steps, step_s),
        memory_for(structure),
        out_q,
        energy,
        info,
    )
    if code != DONE:
        return _failure(int(info[STEP]), step_s)
    base_m = np.zeros(rows) if base is None else base.displacement_m[: steps + 1 : output_every]
    positions = np.atleast_1d(np.asarray(output_positions_m, dtype=np.float64))
    x_m, y_m, angle, axial_m, transverse_m = beam.moved(positions, out_q, base_m)
    return Trajectory(
        time_s=np.arange(rows, dtype=np.float64) * (step_s * output_every),
        positions_m=positions,
        x_m=x_m,
        y_m=y_m,
        angle_rad=angle,
        axial_m=axial_m,
        transverse_m=transverse_m,
        base_m=base_m,
        energy_j=energy,
        final=State(q, terms.true_velocity(q, v)),
        counts=SolverCounts(steps, *(int(count) for count in info[:STEP])),
    )


def longest_step_s(omega_rad_s: float, longest_s: float | None = None) -> float:
    """Longest time step for a motion up to this angular frequency, 0 for any, and at most `longest_s` (0.5 ms)."""
    longest_s = TUNING.longest_step_s if longest_s is None else longest_s
    return min(longest_s, TUNING.largest_phase / omega_rad_s) if omega_rad_s > 0.0 else longest_s


def fitted_modes(beam: AncfBeam, least: int = 1) -> BeamModes:
    """Modes to be exact in a simulation of the beam: eight, at least `least`, at most those of the mesh."""
    return beam_modes(beam, min(max(least, TUNING.fitted_modes), 2 * beam.properties.elements))


def checked_steps(
    beam: AncfBeam, state: State, duration_s: float, step_s: float, output_every: int, base: BaseMotion | None
) -> int:
    """Number of steps, after a check that the arguments match."""
    checked("step_s", step_s, positive=True)
    checked("duration_s", duration_s, at_least=step_s)
    if output_every < 1:
        msg = f"output_every must be at least 1, got {output_every}"
        raise ValueError(msg)
    for name, values in (("q", state.q), ("v", state.v)):
        if values.shape != (beam.ndof,) or not np.all(np.isfinite(values)):
            msg = f"state.{name} must be finite, shape ({beam.ndof},); got shape {values.shape}"
            raise ValueError(msg)
    steps = round(duration_s / step_s)
    if base is not None and base.velocity_m_s.size != steps + 1:
        msg = f"the base motion must have {steps + 1} samples, one more than steps; got {base.velocity_m_s.size}"
        raise ValueError(msg)
    return steps


def _structure(
    beam: AncfBeam,
    modes: BeamModes,
    coefficients: DampingCoefficients,
    levels_s: FloatArray,
    terms: ModalTerms,
    axial_relaxation_s: float,
) -> Structure:
    linear = _linear_matrices(beam, modes, coefficients, levels_s)
    h = levels_s[:, np.newaxis]
    gain = 2.0 * terms.mass / h**2 + terms.damping / h
    is_decoupled = decoupled(linear)
    return Structure(
        mass=diagonals(beam.mass_kg, decoupled=is_decoupled),
        bending=diagonals(beam.bending_n_m, decoupled=is_decoupled),
        linear_columns=lower_columns(linear),
        linear=diagonals(linear, decoupled=is_decoupled),
        rows=terms.rows,
        modal_mass=terms.mass,
        gain=gain,
        low_rank=first_that_matters(gain, levels_s),
        axial=Axial(beam.dshape, np.outer(beam.weight_m, beam.axial_stiffness_n).ravel()),
        air=_air(beam, coefficients.air),
        relaxation_s=(coefficients.stiffness_s, axial_relaxation_s),
        dof_scale=beam.dof_scale,
        tolerance=(TUNING.tolerance, TUNING.smallest_tolerance * beam.properties.length_m),
    )


def _air(beam: AncfBeam, air: StillAir | None) -> Air:
    """Drag at the Gauss points; no points without air."""
    if air is None:
        return Air(np.zeros((0, 4)), np.zeros((0, 4)), np.zeros(0))
    nodes, weights = np.polynomial.legendre.leggauss(TUNING.drag_points)
    at, h = 0.5 * (nodes + 1.0), beam.element_length_m
    half = 0.5 * air.density_kg_m3 * air.drag_coefficient
    return Air(
        shape_functions(at, h),
        shape_functions(at, h, 1),
        np.outer(0.5 * h * weights, half * beam.properties.width_m).ravel(),
    )


def _forcing(
    beam: AncfBeam, terms: ModalTerms, base: BaseMotion | None, steps: int, step_s: float
) -> Forcing:
    rest = np.zeros(steps)
    return Forcing(
        load=beam.weight_load_n,
        inertia=terms.base_force,
        acceleration=rest if base is None else np.diff(base.velocity_m_s) / step_s,
        velocity=rest if base is None else np.diff(base.displacement_m) / step_s,
    )


def _linear_matrices(
    beam: AncfBeam, modes: BeamModes, coefficients: DampingCoefficients, levels_s: FloatArray
) -> FloatArray:
    """Constant part of the tangent at each halving level, shape (levels, ndof, 15)."""
    constant = np.zeros_like(beam.mass_kg)
    if coefficients.constant_stiffness_s != 0.0:
        constant = coefficients.constant_stiffness_s * beam.elastic(modes.equilibrium).tangent
    h = levels_s[:, np.newaxis, np.newaxis]
    return np.asarray(
        beam.mass_kg * (2.0 / h**2 + coefficients.mass_1_s / h)
        + beam.bending_n_m * (0.5 + coefficients.stiffness_s / h)
        + constant / h
    )


def _failure(step: int, step_s: float) -> FailedSimulation:
    reason = (
        f"the step at {step * step_s:.6g} s did not converge, even with substeps of "
        f"{step_s / 2 ** (TUNING.halving_levels - 1):.3g} s. The motion is too fast for the step: "
        f"use a step shorter than {step_s:.3g} s, or a smaller amplitude."
    )
    return FailedSimulation(reason, time_s=step * step_s, step=step)

"""Many simulations of one beam at once: posterior draws of damping and frequency, or starts, side by side.

Runs of the same beam, step and base motion share their matrices; `sim.dynamics.batch.lane_march` advances them
together, at a fraction of what each costs alone. A draw that does not converge there is simulated alone with halvings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.beam.ancf import AncfBeam
from sim.beam.banded import decoupled, diagonals, lower_columns
from sim.beam.modes import BeamModes, beam_modes
from sim.damping import DampingCoefficients, DampingModel
from sim.dynamics.batch.lane_kernels import Blend, Rows
from sim.dynamics.batch.lane_march import LaneForcing, LaneStructure, lane_workspace, march_lanes
from sim.dynamics.forces import Axial
from sim.dynamics.modal_terms import ModalTerms, base_friction, first_that_matters, modal_terms
from sim.dynamics.simulate import DEFAULT_FITTED_MODES, SMALLEST_TOLERANCE, checked_steps, simulate
from sim.dynamics.trajectory import BaseMotion, FailedSimulation, State, Trajectory
from tracker.arrays import FloatArray

# More would leave the second-level cache, fewer would not fill the loops.
LANES_AT_ONCE = 64
# draws are compared with each other, not with the energy of a minute
_RELATIVE_TOLERANCE = 1e-9
# of a modal term's coordinate: what round-off leaves where a straight beam has nothing would cost half of the products
_NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class Draws:
    """Motion of material points in many simulations.

    Attributes
    ----------
    time_s : array, shape (n,)
    positions_m : array, shape (k,)
    axial_m, transverse_m : array, shape (draws, n, k)
        Displacement relative to the clamp along the undeformed beam and across it; NaN in all of a draw that failed.
    base_m : array, shape (n,)
        Transverse displacement of the clamp.
    final : tuple of State or None, length draws
    failed : tuple of FailedSimulation or None, length draws
    alone : int
        Draws that were simulated alone.
    """

    time_s: FloatArray
    positions_m: FloatArray
    axial_m: FloatArray
    transverse_m: FloatArray
    base_m: FloatArray
    final: tuple[State | None, ...]
    failed: tuple[FailedSimulation | None, ...]
    alone: int


def simulate_draws(
    beam: AncfBeam,
    damping: Sequence[DampingModel],
    *,
    states: Sequence[State],
    duration_s: float,
    step_s: float,
    output_positions_m: FloatArray,
    base: BaseMotion | None = None,
    output_every: int = 1,
    modes: BeamModes | None = None,
    target_omega_rad_s: FloatArray | None = None,
    axial_relaxation_s: float = 0.0,
) -> Draws:
    """Integrate the same beam's motion for many damping models and starts.

    Parameters
    ----------
    beam : AncfBeam
    damping : sequence of DampingModel, length draws
        A constant stiffness matrix and air drag have no lanes: such draws are simulated alone.
    states : sequence of State, length draws
    duration_s, step_s, output_positions_m, base, output_every, modes, axial_relaxation_s :
        As in `sim.dynamics.simulate.simulate`, common to all draws.
    target_omega_rad_s : array, shape (draws, m), optional

    Returns
    -------
    Draws
        Equal to single simulations but for the tolerance of the iteration.

    Raises
    ------
    ValueError
        If the arguments do not fit each other.
    """
    if len(damping) != len(states) or not damping:
        msg = f"damping and states need one entry a draw each, got {len(damping)} and {len(states)}"
        raise ValueError(msg)
    if target_omega_rad_s is not None and len(target_omega_rad_s) != len(damping):
        msg = f"target_omega_rad_s needs one row a draw: {len(damping)}, got {len(target_omega_rad_s)}"
        raise ValueError(msg)
    for state in states:
        steps = checked_steps(beam, state, duration_s, step_s, output_every, base)
    if modes is None:
        modes = beam_modes(beam, min(DEFAULT_FITTED_MODES, beam.properties.elements))
    positions = np.atleast_1d(np.asarray(output_positions_m, dtype=np.float64))
    rows = steps // output_every + 1
    plan = _Plan(
        beam, modes, duration_s, step_s, positions, base, output_every, target_omega_rad_s, axial_relaxation_s
    )
    motion = np.full((len(damping), rows, 2 * positions.size), np.nan)
    final = plan.together(damping, states, motion)
    alone = [d for d, end in enumerate(final) if end is None]
    failed: list[FailedSimulation | None] = [None] * len(damping)
    for d in alone:
        run = plan.alone(damping[d], states[d], d)
        if isinstance(run, FailedSimulation):
            failed[d] = run
        else:
            final[d] = run.final
            motion[d] = np.concatenate([run.axial_m, run.transverse_m], axis=1)
    return Draws(
        time_s=np.arange(rows, dtype=np.float64) * (step_s * output_every),
        positions_m=positions,
        axial_m=motion[:, :, : positions.size],
        transverse_m=motion[:, :, positions.size :],
        base_m=np.zeros(rows) if base is None else base.displacement_m[: steps + 1 : output_every],
        final=tuple(final),
        failed=tuple(failed),
        alone=len(alone),
    )


@dataclass(frozen=True)
class _Plan:
    """What all draws have in common."""

    beam: AncfBeam
    modes: BeamModes
    duration_s: float
    step_s: float
    positions_m: FloatArray
    base: BaseMotion | None
    output_every: int
    target_omega_rad_s: FloatArray | None
    axial_relaxation_s: float

    def together(
        self, damping: Sequence[DampingModel], states: Sequence[State], motion: FloatArray
    ) -> list[State | None]:
        """Final states, and `motion` written, of the draws that lanes can solve; None for the others."""
        final: list[State | None] = [None] * len(damping)
        coefficients = [model.coefficients(self.modes) for model in damping]
        suited = [d for d, c in enumerate(coefficients) if c.air is None and c.constant_stiffness_s == 0.0]
        counts = (round(self.duration_s / self.step_s), self.output_every)
        for first in range(0, len(suited), LANES_AT_ONCE):
            chosen = suited[first : first + LANES_AT_ONCE]
            terms = [
                modal_terms(self.modes, coefficients[d], np.array([self.step_s]), self._target(d))
                for d in chosen
            ]
            lanes = _Lanes(self.beam, [coefficients[d] for d in chosen], terms, self.step_s)
            out, ended = lanes.run(
                [states[d] for d in chosen], counts, self.base, self.positions_m, self.axial_relaxation_s
            )
            for lane, d in enumerate(chosen):
                final[d] = ended[lane]
                if ended[lane] is not None:
                    motion[d] = out[:, :, lane]
        return final

    def alone(self, model: DampingModel, state: State, draw: int) -> Trajectory | FailedSimulation:
        """One draw by itself."""
        return simulate(
            self.beam,
            model,
            state=state,
            duration_s=self.duration_s,
            step_s=self.step_s,
            output_positions_m=self.positions_m,
            base=self.base,
            output_every=self.output_every,
            modes=self.modes,
            target_omega_rad_s=self._target(draw),
            axial_relaxation_s=self.axial_relaxation_s,
        )

    def _target(self, draw: int) -> FloatArray | None:
        return None if self.target_omega_rad_s is None else self.target_omega_rad_s[draw]


@dataclass(frozen=True)
class _Lanes:
    """Draws that are advanced together."""

    beam: AncfBeam
    coefficients: list[DampingCoefficients]
    terms: list[ModalTerms]
    step_s: float

    def run(
        self,
        states: list[State],
        counts: tuple[int, int],
        base: BaseMotion | None,
        positions_m: FloatArray,
        axial_relaxation_s: float,
    ) -> tuple[FloatArray, list[State | None]]:
        """Displacements along and across at the outputs, (rows, 2 k, lanes), and final states; None for the dead."""
        q = np.stack([np.asarray(state.q, dtype=np.float64) for state in states], axis=1)
        v = np.stack(
            [t.discrete_velocity(s.q, np.asarray(s.v)) for t, s in zip(self.terms, states, strict=True)],
            axis=1,
        )
        shapes = self.beam.interpolation(positions_m)
        observed = np.zeros((2 * positions_m.size, self.beam.ndof))
        observed[: positions_m.size, 0::2] = shapes
        observed[positions_m.size :, 1::2] = shapes
        out = np.zeros((counts[0] // counts[1] + 1, 2 * positions_m.size, len(states)))
        alive = np.ones(len(states), dtype=np.bool_)
        structure = self._structure(axial_relaxation_s)
        march_lanes(
            counts,
            self.step_s,
            q,
            v,
            structure,
            self._forcing(counts[0], base),
            observed,
            lane_workspace(q, v, structure),
            out,
            alive,
        )
        ended = [
            State(q[:, lane].copy(), self.terms[lane].true_velocity(q[:, lane], v[:, lane]))
            if alive[lane]
            else None
            for lane in range(len(states))
        ]
        return out, ended

    def _structure(self, axial_relaxation_s: float) -> LaneStructure:
        beam, h = self.beam, self.step_s
        apart = decoupled(beam.mass_kg) and decoupled(beam.bending_n_m)
        alpha = np.array([c.mass_1_s for c in self.coefficients])
        beta = np.array([c.stiffness_s for c in self.coefficients])
        rows = self.terms[0].rows
        modal_mass = np.stack([t.mass[0] for t in self.terms], axis=1)
        modal_damping = np.stack([t.damping[0] for t in self.terms], axis=1)
        gain = 2.0 * modal_mass / h**2 + modal_damping / h
        return LaneStructure(
            linear=Blend(
                lower_columns(beam.mass_kg),
                lower_columns(beam.bending_n_m),
                np.ascontiguousarray(diagonals(beam.mass_kg, decoupled=apart).T),
                np.ascontiguousarray(diagonals(beam.bending_n_m, decoupled=apart).T),
                2.0 / h**2 + alpha / h,
                0.5 + beta / h,
            ),
            rows=Rows(rows, np.flatnonzero(np.abs(rows).max(axis=0) > _NEGLIGIBLE * np.abs(rows).max())),
            gain=gain,
            modal_inertia=-2.0 / h * modal_mass,
            axial=Axial(beam.dshape, np.outer(beam.weight_m, beam.axial_stiffness_n)),
            viscosity=(beta / h, (beta + axial_relaxation_s) / h),
            low_rank=int(first_that_matters(np.abs(gain).max(axis=1), np.asarray(h))),
            dof_scale=beam.dof_scale,
            tolerance=(_RELATIVE_TOLERANCE, SMALLEST_TOLERANCE * beam.properties.length_m),
        )

    def _forcing(self, steps: int, base: BaseMotion | None) -> LaneForcing:
        rest = np.zeros(steps)
        return LaneForcing(
            load=self.beam.weight_load_n,
            inertia=np.stack([t.base_force for t in self.terms], axis=1),
            friction=np.stack(
                [base_friction(self.beam, c, t) for c, t in zip(self.coefficients, self.terms, strict=True)],
                axis=1,
            ),
            acceleration=rest if base is None else np.diff(base.velocity_m_s) / self.step_s,
            velocity=rest if base is None else np.diff(base.displacement_m) / self.step_s,
        )

r"""Steady state under a harmonic base motion as a periodic solution: a state that repeats after one period.

With P the map over one period, the fixed point x = P(x) is found by Newton's method in the slow coordinates, those of
the lower modes, with dP/dx from finite differences (`sim.dynamics.batch.draws`), and by fixed-point iteration in the
others, which decay within some dozens of periods (Lust, Roose 1998). A simulation from rest would need
``ln(1000) / (2 pi zeta)`` periods to come within a thousandth of it, 400 at the damping of these beams.

References
----------
Lust, Roose, Spence, Champneys, "An adaptive Newton-Picard algorithm with subspace iteration for computing periodic
solutions", SIAM J. Sci. Comput. 19 (1998) 1188-1209, doi:10.1137/S1064827594277673.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.beam.ancf import AncfBeam, from_band
from sim.beam.modes import BeamModes, beam_modes
from sim.damping import DampingModel
from sim.dynamics.batch.draws import simulate_draws
from sim.dynamics.simulate import simulate
from sim.dynamics.trajectory import BaseMotion, FailedSimulation, State, Trajectory
from tracker.arrays import FloatArray

DEFAULT_STEPS_PER_CYCLE = 40
_LONGEST_STEP_S = 1e-3
_MAX_ITERATIONS = 400
# iterations during which the derivative may be updated because the residual decreases slowly
_WITH_NEW_SLOPE = 12
# (n, share): no convergence if the residual exceeds this share of the amplitude after n iterations
_HOPELESS = (40, 1e-3)
# modes of the slow coordinates; higher ones must decay within a few periods
_SLOW_MODES = 12
# finite difference of a slow coordinate, relative to the largest of them
_DIFFERENCE = 1e-3
# the derivative is updated where the residual does not decrease to this share
_SLOW_FALL = 0.3
# largest change of a slow coordinate per iteration, relative to the largest of them
_LARGEST_MOVE = 0.2
# tolerance of the other coordinates, as a multiple of that of the slow ones
_REST = 100.0


@dataclass(frozen=True)
class SteadyState:
    """A periodic motion.

    Attributes
    ----------
    state : State
        At the instant when the base passes its middle position in the positive direction.
    cycle : Trajectory
        One period from that instant, output at every step.
    step_s : float
        An integer fraction of the period.
    residual : float
        Change of the displacement over one period, relative to the amplitude.
    iterations : int
    multiplier : float
        Largest Floquet multiplier of the slow coordinates: growth of a small disturbance per period, below 1.
    """

    state: State
    cycle: Trajectory
    step_s: float
    residual: float
    iterations: int
    multiplier: float


@dataclass(frozen=True)
class _Cycle:
    """The map over one period and its slow coordinates."""

    beam: AncfBeam
    damping: DampingModel
    modes: BeamModes
    slow_modes: BeamModes
    base: BaseMotion
    omega_rad_s: float
    step_s: float
    axial_relaxation_s: float

    def run(self, state: State) -> Trajectory | FailedSimulation:
        return simulate(
            self.beam,
            self.damping,
            state=state,
            duration_s=self.period_s,
            step_s=self.step_s,
            output_positions_m=np.array([self.beam.properties.length_m]),
            base=self.base,
            modes=self.modes,
            axial_relaxation_s=self.axial_relaxation_s,
        )

    def runs(self, states: list[State]) -> tuple[State | None, ...]:
        return simulate_draws(
            self.beam,
            [self.damping] * len(states),
            states=states,
            duration_s=self.period_s,
            step_s=self.step_s,
            output_positions_m=np.array([self.beam.properties.length_m]),
            base=self.base,
            modes=self.modes,
            axial_relaxation_s=self.axial_relaxation_s,
        ).final

    @property
    def period_s(self) -> float:
        return self.step_s * (self.base.velocity_m_s.size - 1)

    def slow(self, before: State, after: State) -> FloatArray:
        """Change of the modal coordinates and of their rates over omega, shape (2 m,)."""
        rows = (self.beam.mass_matrix() @ self.slow_modes.phi).T
        return np.concatenate([rows @ (after.q - before.q), rows @ (after.v - before.v) / self.omega_rad_s])

    def moved(self, state: State, slow: FloatArray) -> State:
        """`state` with changed slow coordinates, without axial strain."""
        m = self.slow_modes.count
        loads = self.beam.mass_matrix() @ (self.slow_modes.phi * self.slow_modes.omega_rad_s**2)
        family = np.linalg.solve(from_band(self.beam.elastic(state.q).tangent), loads)
        return State(state.q + family @ slow[:m], state.v + family @ (slow[m:] * self.omega_rad_s))

    def amplitude(self, state: State) -> float:
        q, v = state.q - self.modes.equilibrium, state.v / self.omega_rad_s
        return float(np.sqrt(np.max(np.square(q * self.beam.dof_scale) + np.square(v * self.beam.dof_scale))))

    def change(self, before: State, after: State) -> float:
        """Largest change of a coordinate, in m.

        Only slow velocities are required to repeat: with the midpoint rule the stiffest axial velocities alternate from
        step to step, with a negligible displacement.
        """
        return float(np.max(np.abs((after.q - before.q) * self.beam.dof_scale)))

    def slope(self, state: State) -> _Slope | None:
        """Derivative of the map over one period at `state`; None where a perturbed motion fails.

        Two periods are simulated: a perturbation of the shape alone lacks its part of axial motion, and acquires it
        during the first period with an impulse on the slow coordinates. The second period has none.
        """
        size = 2 * self.slow_modes.count
        step = _DIFFERENCE * float(
            np.abs(self.slow(State(self.modes.equilibrium, 0.0 * state.v), state)).max()
        )
        starts = [self.moved(state, step * sign * row) for row in np.eye(size) for sign in (1.0, -1.0)]
        middles = _complete(self.runs(starts))
        ends = None if middles is None else _complete(self.runs(middles))
        if middles is None or ends is None:
            return None
        first, second = (
            np.stack([self.slow(down, up) for up, down in _pairs(states)], axis=1)
            for states in (middles, ends)
        )
        q, v = (
            np.stack([up - down for up, down in _pairs([getattr(x, name) for x in middles])], axis=1)
            for name in ("q", "v")
        )
        inverse = np.linalg.pinv(first)
        return _Slope(second @ inverse, q @ inverse, v @ inverse)


@dataclass(frozen=True)
class _Slope:
    """dP/dx over the slow coordinates, (2 m, 2 m), and the change of state per unit of each, (ndof, 2 m)."""

    matrix: FloatArray
    q: FloatArray
    v: FloatArray

    def moved(self, state: State, slow: FloatArray) -> State:
        return State(state.q + self.q @ slow, state.v + self.v @ slow)

    @property
    def multiplier(self) -> float:
        """Largest Floquet multiplier."""
        return float(np.abs(np.linalg.eigvals(self.matrix)).max())


def _complete(states: tuple[State | None, ...]) -> list[State] | None:
    found = [state for state in states if state is not None]
    return found if len(found) == len(states) else None


def _pairs(values: list[Any]) -> zip[tuple[Any, Any]]:
    return zip(values[0::2], values[1::2], strict=True)


def steady_state(
    beam: AncfBeam,
    damping: DampingModel,
    modes: BeamModes,
    *,
    base_amplitude_m: float,
    omega_rad_s: float,
    start: State,
    steps_per_cycle: int = DEFAULT_STEPS_PER_CYCLE,
    axial_relaxation_s: float = 1e-4,
    tolerance: float = 1e-6,
) -> SteadyState | FailedSimulation:
    """Periodic motion under the base motion ``base_amplitude_m sin(omega t)``, however large.

    Parameters
    ----------
    beam, damping, modes :
        The modes are those whose discrete frequency is exact. The beam's first twelve are the slow coordinates; higher
        ones must be damped.
    base_amplitude_m, omega_rad_s : float
    start : State
        First guess at the instant when the base passes its middle, as from
        `sim.dynamics.excitation.linear_steady_state`.
    steps_per_cycle : int
        Minimum; no step is longer than 1 ms.
    axial_relaxation_s : float
        As in `sim.dynamics.simulate.simulate`.
    tolerance : float
        Largest change of a slow coordinate over a period, relative to the largest of them. For the others it is a
        hundred times as large: their errors do not accumulate, and unresolved axial motion does not repeat exactly.

    Returns
    -------
    SteadyState or FailedSimulation
        The latter if a period cannot be simulated, the iteration does not converge, or the periodic motion is unstable;
        near a fold of the resonance curve another steady state may exist.

    Raises
    ------
    ValueError
        If amplitude or frequency is not finite and positive.
    """
    if not (0.0 < base_amplitude_m < np.inf and 0.0 < omega_rad_s < np.inf and steps_per_cycle >= 8):
        msg = (
            "base_amplitude_m and omega_rad_s must be finite and positive and steps_per_cycle at least 8, got "
            f"{base_amplitude_m} m, {omega_rad_s} rad/s and {steps_per_cycle}"
        )
        raise ValueError(msg)
    period_s = 2.0 * np.pi / omega_rad_s
    steps = max(steps_per_cycle, int(np.ceil(period_s / _LONGEST_STEP_S)))
    time_s = np.arange(steps + 1) * (period_s / steps)
    base = BaseMotion(
        base_amplitude_m * np.sin(omega_rad_s * time_s),
        base_amplitude_m * omega_rad_s * np.cos(omega_rad_s * time_s),
    )
    slow_modes = beam_modes(
        beam, min(max(_SLOW_MODES, modes.count), 2 * beam.properties.elements), modes.equilibrium
    )
    cycle = _Cycle(beam, damping, modes, slow_modes, base, omega_rad_s, period_s / steps, axial_relaxation_s)
    state, slope, previous = start, None, np.inf
    for iteration in range(1, _MAX_ITERATIONS + 1):
        run = cycle.run(state)
        if isinstance(run, FailedSimulation):
            return run
        residual = cycle.change(state, run.final) / cycle.amplitude(run.final)
        missed = cycle.slow(state, run.final)
        own = np.abs(cycle.slow(State(modes.equilibrium, 0.0 * state.v), run.final)).max()
        if np.abs(missed).max() < tolerance * own and residual < _REST * tolerance:
            return _stable(cycle, state, run, residual, iteration)
        if slope is None or residual > (_SLOW_FALL if iteration <= _WITH_NEW_SLOPE else 1.0) * previous:
            slope = cycle.slope(state)
        if slope is None or (iteration > _HOPELESS[0] and residual > _HOPELESS[1]):
            break
        wanted = np.linalg.lstsq(np.eye(missed.size) - slope.matrix, missed, rcond=None)[0]
        # far from the linear response the derivative is unreliable: a change as large as the motion would strain the
        # beam
        wanted *= min(1.0, _LARGEST_MOVE * own / np.abs(wanted).max())
        state = slope.moved(run.final, wanted - missed)
        previous = residual
    reason = (
        f"no steady state was found: after {iteration} periods the state still changes by {100 * residual:.2g} % of "
        "its amplitude per period. Use more modes, more damping, or a smaller amplitude."
    )
    return FailedSimulation(time_s=0.0, step=0, reason=reason)


def _stable(
    cycle: _Cycle, state: State, run: Trajectory, residual: float, iteration: int
) -> SteadyState | FailedSimulation:
    """The periodic motion, if it is stable."""
    slope = cycle.slope(state)
    if slope is None or slope.multiplier >= 1.0:
        grows = "without bound" if slope is None else f"by a factor {slope.multiplier:.4g} per period"
        tip_m = 0.5 * float(np.ptp(run.transverse_m))
        reason = (
            f"a periodic motion with a tip amplitude of {1e3 * tip_m:.3g} mm was found, but it is unstable: a small "
            f"disturbance grows {grows}. Use a smaller amplitude of the base."
        )
        return FailedSimulation(time_s=0.0, step=0, reason=reason)
    return SteadyState(state, run, cycle.step_s, residual, iteration, slope.multiplier)

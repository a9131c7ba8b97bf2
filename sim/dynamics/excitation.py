"""Initial states, from a shape, modal amplitudes or base excitation, and the free decay of one mode.

Modal displacements are not simply superposed on the equilibrium: a straight beam displaced by 0.1 mm of the paper's
fifth mode would have a spurious tension of newtons. The initial shape is the static equilibrium under the load
``M phi a``, and the initial velocity is tangent to the family of such equilibria.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.beam import (
    AncfBeam,
    Beam,
    BeamModes,
    BeamProperties,
    NoEquilibriumError,
    ancf_beam,
    static_equilibrium,
    stiffness,
)
from sim.damping import DampingModel, GenericDamping
from sim.dynamics.simulate import (
    BaseMotion,
    FailedSimulation,
    State,
    Trajectory,
    fitted_modes,
    longest_step_s,
    simulate,
)
from tracker import ComplexArray, FloatArray, data_frame

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Tuning:
    """Convergence of initial states."""

    #: [1] iterations on the loads of a state with given modal coordinates or tip; beyond: no equilibrium
    #: convention: 2 to 8, the latter at 350 mm of a beam of 500 mm; the rest is reserve.
    rounds: int = 60
    #: [1] error of a modal coordinate at convergence, over the largest
    #: physics: A hundredth of the accuracy of a simulated decay, 1e-7.
    coordinate_error: float = 1e-9
    #: [lengths] error of the tip's displacement at convergence
    #: physics: Statics is accurate to 1e-12 lengths with 20 elements, and less accurate with more.
    tip_error: float = 1e-10
    #: [1] largest change of the load in an iteration, over the load
    #: convention: Chosen; keeps Newton's method on the branch of the equilibrium where the beam stiffens.
    longest_move: float = 2.0


TUNING = Tuning()


@dataclass(frozen=True)
class HarmonicThenStop:
    """Base motion ``b(t) = amplitude sin(omega (t - stop))`` until `stop_s`, then brought to rest.

    At the stop the base passes its middle position and a beam at resonance its largest displacement. The amplitude then
    falls to zero within `fade_s` as a quintic, which keeps the acceleration continuous.
    """

    amplitude_m: float
    omega_rad_s: float
    stop_s: float
    fade_s: float

    def __call__(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Displacement in m and velocity in m/s at `time_s`."""
        phase = self.omega_rad_s * (time_s - self.stop_s)
        x = np.clip((time_s - self.stop_s) / self.fade_s, 0.0, 1.0)
        left = 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        fall = -30.0 * x**2 * (1.0 - x) ** 2 / self.fade_s
        displacement = self.amplitude_m * left * np.sin(phase)
        velocity = self.amplitude_m * (left * self.omega_rad_s * np.cos(phase) + fall * np.sin(phase))
        return displacement, velocity


def state_from_modes(
    beam: AncfBeam, modes: BeamModes, displacement: FloatArray, velocity: FloatArray
) -> State:
    """State with the given modal coordinates, without spurious tension.

    Parameters
    ----------
    displacement, velocity : array, shape (m,)
        Modal coordinates (m kg^1/2) and their rates for the first m modes. For a fitted complex amplitude c of a mode
        with exponent s they are ``Re c`` and ``Re(s c)``.

    Raises
    ------
    NoEquilibriumError
        If the load has no equilibrium.
    """
    count = displacement.size
    loads = beam.mass_matrix() @ (modes.phi[:, :count] * modes.omega_rad_s[:count] ** 2)
    q = static_equilibrium(beam, loads @ displacement)
    return State(q, np.asarray(np.linalg.solve(stiffness(beam, q), loads @ velocity)))


def state_with_coordinates(
    beam: AncfBeam, modes: BeamModes, displacement: FloatArray, velocity: FloatArray
) -> State:
    """State of the family of `state_from_modes` with exactly the given modal coordinates of all `modes`, however large.

    Under the load of linear theory, large displacements have components in the softer modes: 0.4 mm at the tip in the
    paper's fifth mode has 0.06 mm of the first. Here ``phi^T M (q - q_eq)`` and ``phi^T M v`` equal the given values.

    Raises
    ------
    NoEquilibriumError
        If the loads have no equilibrium, or the iteration does not converge.
    """
    count = displacement.size
    rows = (beam.mass_matrix() @ modes.phi[:, :count]).T
    loads = rows.T * modes.omega_rad_s[:count] ** 2
    share, q = displacement.copy(), modes.equilibrium
    for _ in range(TUNING.rounds):
        q = static_equilibrium(beam, loads @ share, start=q)
        family = np.linalg.solve(stiffness(beam, q), loads)
        moved = rows @ family
        missed = displacement - rows @ (q - modes.equilibrium)
        if np.max(np.abs(missed)) <= TUNING.coordinate_error * np.max(np.abs(displacement), initial=0.0):
            return State(q, np.asarray(family @ np.linalg.solve(moved, velocity)))
        share = share + np.linalg.solve(moved, missed)
    msg = "no static shape with these modal coordinates was found: the motion is too large for modes about the rest"
    raise NoEquilibriumError(msg)


def released_state(beam: AncfBeam, modes: BeamModes, mode_number: int, tip_displacement_m: float) -> State:
    """State at rest under the load of one mode, with the given displacement of its antinode, however large.

    Raises
    ------
    ValueError
        If this load cannot displace it that far.
    """
    unit = np.zeros(mode_number)
    unit[-1] = 1.0
    tip = modes.antinode_m(mode_number)
    load = beam.mass_matrix() @ modes.phi[:, mode_number - 1] * modes.omega_rad_s[mode_number - 1] ** 2
    rest = beam.transverse_at(tip, modes.equilibrium)[0]
    coordinate = tip_displacement_m / modes.transverse_at(tip)[0, mode_number - 1]
    q = modes.equilibrium
    for _ in range(TUNING.rounds):
        q = static_equilibrium(beam, coordinate * load, start=q)
        miss = tip_displacement_m - (beam.transverse_at(tip, q)[0] - rest)
        if abs(miss) < TUNING.tip_error * beam.properties.length_m:
            return State(q, np.zeros_like(q))
        slope = beam.transverse_at(tip, np.linalg.solve(stiffness(beam, q), load))[0]
        most = TUNING.longest_move * abs(coordinate)
        coordinate += float(np.clip(miss / slope, -most, most))
    msg = f"no load of mode {mode_number} displaces the tip by {tip_displacement_m} m"
    raise ValueError(msg)


def shake_and_stop(
    beam: AncfBeam,
    damping: DampingModel,
    modes: BeamModes,
    *,
    mode_number: int,
    tip_amplitude_m: float,
    shake_s: float,
    decay_s: float,
    step_s: float,
    stop_s: float,
    output_positions_m: FloatArray,
    axial_relaxation_s: float = 1e-4,
) -> Trajectory | FailedSimulation:
    """Drive the clamp at the resonance of a mode, stop it suddenly, and let the beam decay.

    The motion begins in the steady response of the linearised beam, all of `modes` superposed, and is driven for
    `shake_s`. For small motion this is the steady state; otherwise (mode 3 of the paper's beam above 0.5 mm, mode 5
    above 0.2 mm) the motion drifts from it at the rate of the damping.

    Parameters
    ----------
    beam, damping, modes :
        The modes must be those of `beam`, more than the damping model has.
    mode_number : int
        1 first; the base moves at the undamped frequency of the mode.
    tip_amplitude_m : float
        Steady amplitude of the tip relative to the base by linear theory; it determines the amplitude of the base.
    shake_s, decay_s, stop_s : float
        Duration before and after the beginning of the stop, and of the stop.
    step_s, output_positions_m, axial_relaxation_s :
        As in `simulate`; the stop excites axial waves that the steps do not resolve.

    Raises
    ------
    ValueError
        If the mode is not among `modes`, or is undamped and has no steady state.
    """
    if not 1 <= mode_number <= modes.count:
        msg = f"mode_number must lie between 1 and {modes.count}, got {mode_number}"
        raise ValueError(msg)
    ratio = damping.coefficients(modes).damping_ratio
    if ratio[mode_number - 1] <= 0.0:
        msg = f"mode {mode_number} is undamped and has no steady state at resonance; give a damping model"
        raise ValueError(msg)
    omega = float(modes.omega_rad_s[mode_number - 1])
    tip = modes.transverse_at(modes.antinode_m(mode_number))[0]
    response = steady_response(modes, ratio, omega)
    amplitude = tip_amplitude_m / abs(complex(tip @ response))
    motion = HarmonicThenStop(amplitude, omega, shake_s, stop_s)
    # b = Re(-i amplitude exp(i phase)), with the phase -omega shake_s at the start
    start = response * (-1j * amplitude * np.exp(-1j * omega * shake_s))
    try:
        state = state_from_modes(beam, modes, start.real, (1j * omega * start).real)
    except NoEquilibriumError as error:
        return FailedSimulation(f"no static shape was found for the steady state: {error}")
    steps = round((shake_s + decay_s) / step_s)
    return simulate(
        beam,
        damping,
        state=state,
        duration_s=steps * step_s,
        step_s=step_s,
        output_positions_m=output_positions_m,
        base=BaseMotion.sample(motion, step_s, steps),
        modes=modes,
        axial_relaxation_s=axial_relaxation_s,
    )


def steady_response(modes: BeamModes, damping_ratio: FloatArray, omega_rad_s: float) -> ComplexArray:
    """Complex modal coordinates of the steady motion under a base displacement of unit amplitude, shape (m,)."""
    own = modes.omega_rad_s
    dynamic = own**2 - omega_rad_s**2 + 2j * damping_ratio * own * omega_rad_s
    return np.asarray(modes.base_participation() * omega_rad_s**2 / dynamic, dtype=np.complex128)


class SimulationError(ArithmeticError):
    """The simulation did not reach its end; the text gives the time and the reason."""


@dataclass(frozen=True)
class FreeDecay:
    """Free decay of one mode, released from rest.

    Attributes
    ----------
    frequency_hz : float
        Natural frequency of the mode at small amplitude.
    tip_mm : array, shape (n,)
        Transverse displacement of the tip from the static equilibrium.
    trajectory : Trajectory
        Motion of the tip in the plane, energy and solver statistics.
    """

    mode: int
    frequency_hz: float
    damping: DampingModel
    time_s: FloatArray
    tip_mm: FloatArray
    trajectory: Trajectory

    def to_dataframe(self) -> pd.DataFrame:
        """Columns ``time_s`` and ``tip_mm``, one row per step."""
        values = {"time_s": self.time_s, "tip_mm": self.tip_mm}
        return data_frame(values, {"time_s": "s", "tip_mm": "mm"})

    def plot(self, ax: Any = None) -> Any:
        """Tip displacement against time; returns the matplotlib Axes."""
        import matplotlib.pyplot as plt  # noqa: PLC0415

        ax = plt.figure().add_subplot() if ax is None else ax
        ax.plot(self.time_s, self.tip_mm, linewidth=0.8)
        ax.set(xlabel="time (s)", ylabel="tip displacement (mm)", title=f"Free decay of mode {self.mode}")
        return ax

    def __repr__(self) -> str:
        return (
            f"FreeDecay(mode {self.mode}, {self.frequency_hz:.4g} Hz, {abs(self.tip_mm[0]):.4g} mm at the tip, "
            f"{self.time_s[-1]:.4g} s, {self.time_s.size} samples)"
        )

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(index=False, max_rows=10))


def simulate_free_decay(
    beam: Beam | BeamProperties,
    damping: DampingModel | float | Sequence[float],
    *,
    mode: int = 1,
    tip_amplitude_mm: float,
    duration_s: float,
    step_s: float | None = None,
) -> FreeDecay:
    """Release the beam from the static shape of one mode and let it decay.

    Parameters
    ----------
    beam : Beam
    damping : DampingModel, float or sequence of float
        A number is the damping ratio of all modes up to `mode`, a sequence those of modes 1, 2, ... (`GenericDamping`).
    mode : int
        1 first.
    tip_amplitude_mm : float
        Transverse displacement of the tip at the start; large displacements are exact.
    duration_s : float
    step_s : float, optional
        The shorter of 0.5 ms and 0.35 / omega of the mode when absent.

    Returns
    -------
    FreeDecay

    Raises
    ------
    ValueError
        If a value is out of range, or the tip cannot be displaced that far.
    SimulationError
        If a step does not converge.

    Examples
    --------
    >>> from sim.beam.beam import Beam
    >>> from sim.dynamics.excitation import simulate_free_decay
    >>> beam = Beam(length_mm=500, width_mm=5, thickness_mm=0.5, density_kg_m3=8000, elastic_modulus_mpa=210_000)
    >>> simulate_free_decay(beam, 0.01, mode=2, tip_amplitude_mm=2.0, duration_s=1.0)
    FreeDecay(mode 2, 10.58 Hz, 2 mm at the tip, 1 s, 2001 samples)
    """
    if mode < 1:
        msg = f"mode must be 1 or more, got {mode}"
        raise ValueError(msg)
    model = _damping_model(damping, mode)
    assembled = ancf_beam(beam)
    properties = assembled.properties
    modes = fitted_modes(assembled, max(mode + 1, model.least_beam_modes))
    if mode > modes.count:
        msg = f"mode must be at most {modes.count} with {properties.elements} elements, got {mode}"
        raise ValueError(msg)
    omega = float(modes.omega_rad_s[mode - 1])
    tip_m = modes.antinode_m(mode)
    run = simulate(
        assembled,
        model,
        state=released_state(assembled, modes, mode, 1e-3 * tip_amplitude_mm),
        duration_s=duration_s,
        step_s=longest_step_s(omega) if step_s is None else step_s,
        output_positions_m=tip_m,
        modes=modes,
    )
    if isinstance(run, FailedSimulation):
        raise SimulationError(run.reason)
    rest_m = assembled.transverse_at(tip_m, modes.equilibrium)
    return FreeDecay(
        mode, omega / (2.0 * np.pi), model, run.time_s, 1e3 * (run.transverse_m - rest_m)[:, 0], run
    )


def _damping_model(damping: DampingModel | float | Sequence[float], mode: int) -> DampingModel:
    if isinstance(damping, DampingModel):
        return damping
    if isinstance(damping, int | float):
        return GenericDamping((float(damping),) * mode)
    return GenericDamping(tuple(float(ratio) for ratio in damping))

"""Free decay of one mode, for use from Python: a beam, a damping model, an amplitude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.beam import Beam, BeamProperties, ancf_beam, beam_modes
from sim.damping import DampingModel, GenericDamping
from sim.dynamics.excitation import released_state
from sim.dynamics.simulate import DEFAULT_FITTED_MODES, simulate
from sim.dynamics.trajectory import FailedSimulation, Trajectory
from tracker import FloatArray

if TYPE_CHECKING:
    import pandas as pd

_LONGEST_STEP_S = 5e-4
# largest phase of the mode per step, omega h
_LARGEST_PHASE = 0.35


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
        import pandas as pd  # noqa: PLC0415

        return pd.DataFrame({"time_s": self.time_s, "tip_mm": self.tip_mm})

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
    >>> from sim.dynamics.free_decay import simulate_free_decay
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
    count = max(mode + 1, DEFAULT_FITTED_MODES, model.least_beam_modes)
    modes = beam_modes(assembled, min(count, 2 * properties.elements))
    if mode > modes.count:
        msg = f"mode must be at most {modes.count} with {properties.elements} elements, got {mode}"
        raise ValueError(msg)
    omega = float(modes.omega_rad_s[mode - 1])
    tip_m = np.array([properties.length_m])
    run = simulate(
        assembled,
        model,
        state=released_state(assembled, modes, mode, 1e-3 * tip_amplitude_mm),
        duration_s=duration_s,
        step_s=min(_LONGEST_STEP_S, _LARGEST_PHASE / omega) if step_s is None else step_s,
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

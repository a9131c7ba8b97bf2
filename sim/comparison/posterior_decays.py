"""Motion of one beam for draws from a posterior of frequencies and damping ratios, at the times of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from sim.beam.ancf import AncfBeam
from sim.beam.modes import BeamModes
from sim.damping import DampingModel
from sim.dynamics.batch.draws import Draws, simulate_draws
from sim.dynamics.trajectory import FailedSimulation, State
from tracker.arrays import FloatArray

# least number of steps for a cubic spline
_FEWEST_STEPS = 3


@dataclass(frozen=True)
class PosteriorDecays:
    """Decays of many draws.

    Attributes
    ----------
    time_s : array, shape (n,)
        As given.
    displacement_m : array, shape (draws, n, k)
        Along the given direction, from the static equilibrium; all NaN for a failed draw.
    failed : tuple of FailedSimulation or None, length draws
    """

    time_s: FloatArray
    displacement_m: FloatArray
    failed: tuple[FailedSimulation | None, ...]


def posterior_decays(
    beam: AncfBeam,
    modes: BeamModes,
    damping: Sequence[DampingModel],
    *,
    states: State | Sequence[State],
    time_s: FloatArray,
    positions_m: FloatArray,
    step_s: float,
    direction: tuple[float, float] | None = None,
    target_omega_rad_s: FloatArray | None = None,
    axial_relaxation_s: float = 0.0,
) -> PosteriorDecays:
    """Simulate a free decay for each draw, at arbitrary times.

    Parameters
    ----------
    beam, modes :
        Discrete frequencies and damping ratios of the modes are exact.
    damping : sequence of DampingModel, length draws
        One per draw, as ``GenericDamping(tuple(zeta))`` or ``RayleighDamping.from_modes`` of the drawn ratios.
    states : State, or sequence of State of length draws
        At time 0; a single state is common to all draws.
    time_s : array, shape (n,)
        Times from 0 on, in any order; a cubic spline interpolates between the steps.
    positions_m : array, shape (k,)
        Distances from the clamp.
    step_s : float
        With 2 pi f step_s = 0.3 for the highest mode present, the error of the spline is 2e-5 of its amplitude.
    direction : tuple of float, optional
        Unit vector in the image (x right, y up); across the undeformed beam when absent.
    target_omega_rad_s : array, shape (draws, m), optional
        Drawn undamped angular frequencies of the first m modes; those of `modes` when absent.
    axial_relaxation_s : float
        As in `sim.dynamics.simulate.simulate`.

    Returns
    -------
    PosteriorDecays
        A quantile over its first axis is a pointwise band.

    Raises
    ------
    ValueError
        If there are no times, a time is not finite or negative, or the arguments do not match.
    """
    time = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
    if time.size == 0 or not np.all(np.isfinite(time)) or time.min() < 0.0:
        msg = f"time_s must hold finite times from 0 on; got {time.size} from {time.min(initial=np.inf)} s"
        raise ValueError(msg)
    steps = max(_FEWEST_STEPS, int(np.ceil(time.max() / step_s * (1.0 - 1e-12))))
    drawn = simulate_draws(
        beam,
        damping,
        states=[states] * len(damping) if isinstance(states, State) else states,
        duration_s=steps * step_s,
        step_s=step_s,
        output_positions_m=positions_m,
        modes=modes,
        target_omega_rad_s=target_omega_rad_s,
        axial_relaxation_s=axial_relaxation_s,
    )
    displacement = np.full((len(damping), time.size, drawn.positions_m.size), np.nan)
    good = [d for d, failure in enumerate(drawn.failed) if failure is None]
    if good:
        moved = _moved(beam, modes, drawn, beam.transverse if direction is None else direction)[good]
        displacement[good] = CubicSpline(drawn.time_s, moved, axis=1)(time)
    return PosteriorDecays(time_s=time, displacement_m=displacement, failed=drawn.failed)


def _moved(beam: AncfBeam, modes: BeamModes, drawn: Draws, direction: tuple[float, float]) -> FloatArray:
    """Displacement from the equilibrium along a direction in the image, shape (draws, n, k)."""
    axial = drawn.axial_m - beam.axial_at(drawn.positions_m, modes.equilibrium)
    across = drawn.transverse_m - beam.transverse_at(drawn.positions_m, modes.equilibrium)
    return np.asarray(axial * np.dot(beam.axis, direction) + across * np.dot(beam.transverse, direction))

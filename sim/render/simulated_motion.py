"""Motion of the whole beam in a recorded decay, simulated from the fitted state with an identified damping model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from modal_id import Identification
from sim.beam import AncfBeam, BeamProperties, BuckledBeamError, NoEquilibriumError
from sim.comparison import decay_setting, match_modes
from sim.damping import DampingModel
from sim.dynamics import FailedSimulation, fitted_modes, simulate
from tracker import Failure, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Length of the simulation."""

    #: [steps] steps simulated beyond the times requested
    #: physics: For the exposure of a frame, 4 ms at 0.5 ms, and three points of a spline's end.
    spare_steps: int = 8


TUNING = Tuning()


@dataclass(frozen=True)
class SimulatedMotion:
    """Motion of k material points of a simulated beam in the recording's time.

    Attributes
    ----------
    time_s : array, shape (n,)
        From slightly before the first time requested to slightly after the last.
    x_m, y_m, angle_rad : array, shape (n, k)
        The clamp at the origin, right and up; rotation counter-clockwise from the undeformed beam.
    rest_x_m, rest_y_m : array, shape (k,)
    axis : tuple of float
        Unit vector along which the recording's mode moves the points, with the sign of the series.
    """

    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    angle_rad: FloatArray
    rest_x_m: FloatArray
    rest_y_m: FloatArray
    axis: tuple[float, float]


def simulated_motion(
    properties: BeamProperties,
    identification: Identification,
    damping: DampingModel,
    *,
    positions_m: FloatArray,
    from_s: float,
    until_s: float,
    highest_mode: int = 0,
) -> SimulatedMotion | Failure:
    """Simulate a recorded decay from the state fitted at ``onset.fit_from_s``, at the measured frequencies.

    Of points at the distances `positions_m`, (k,), from the clamp, in a part of the recording not before the beginning
    of the fit. `highest_mode` is that of the damping model.
    """
    beam = AncfBeam(properties)
    try:
        modes = fitted_modes(beam, highest_mode + 1)
        matched = match_modes(identification, modes)
        if isinstance(matched, Failure):
            return matched
        setting = decay_setting(beam, modes, identification, matched)
        state = setting.start()
    except (BuckledBeamError, NoEquilibriumError) as error:
        return Failure(str(error))
    step_s, start_s = setting.step_s, identification.onset.fit_from_s
    moved = partial(
        simulate, beam, damping, step_s=step_s, modes=modes, target_omega_rad_s=setting.omega_rad_s
    )
    before = max(0, int((from_s - start_s) / step_s) - TUNING.spare_steps)
    if before:
        # only the final state is needed
        skipped = moved(
            state=state, duration_s=before * step_s, output_positions_m=positions_m[:1], output_every=before
        )
        if isinstance(skipped, FailedSimulation):
            return skipped
        state = skipped.final
    first_s = start_s + before * step_s
    steps = max(4, int(np.ceil((until_s - first_s) / step_s)) + TUNING.spare_steps)
    run = moved(state=state, duration_s=steps * step_s, output_positions_m=positions_m)
    if isinstance(run, FailedSimulation):
        return run
    rest_x, rest_y, _ = beam.points(positions_m, modes.equilibrium)
    return SimulatedMotion(
        first_s + run.time_s, run.x_m, run.y_m, run.angle_rad, rest_x, rest_y, matched.axis
    )

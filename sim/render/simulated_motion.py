"""Motion of the whole beam in a recorded decay, simulated from the fitted state with an identified damping model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from modal_id import Identification
from sim.beam import AncfBeam, BeamProperties, BuckledBeamError, NoEquilibriumError, beam_modes
from sim.comparison import decay_setting, match_modes
from sim.damping import DampingModel
from sim.dynamics import FailedSimulation, simulate
from tracker import FloatArray

_MODES = 8
# steps beyond the times requested: for a frame's exposure and the ends of a spline
_SPARE_STEPS = 8


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
    highest_mode: int = _MODES,
) -> SimulatedMotion | FailedSimulation | str:
    """Simulate a recorded decay from the state fitted at ``onset.fit_from_s``, at the measured frequencies.

    Of points at the distances `positions_m`, (k,), from the clamp, in a part of the recording not before the beginning
    of the fit; a text is the reason why there is none. `highest_mode` is that of the damping model.
    """
    beam = AncfBeam(properties)
    try:
        modes = beam_modes(beam, min(max(_MODES, highest_mode + 1), 2 * properties.elements))
        matched = match_modes(identification, modes)
        if isinstance(matched, str):
            return matched
        setting = decay_setting(beam, modes, identification, matched)
        state = setting.start()
    except (BuckledBeamError, NoEquilibriumError) as error:
        return str(error)
    step_s, start_s = setting.step_s, identification.onset.fit_from_s
    moved = partial(
        simulate, beam, damping, step_s=step_s, modes=modes, target_omega_rad_s=setting.omega_rad_s
    )
    before = max(0, int((from_s - start_s) / step_s) - _SPARE_STEPS)
    if before:
        # only the final state is needed
        skipped = moved(
            state=state, duration_s=before * step_s, output_positions_m=positions_m[:1], output_every=before
        )
        if isinstance(skipped, FailedSimulation):
            return skipped
        state = skipped.final
    first_s = start_s + before * step_s
    steps = max(4, int(np.ceil((until_s - first_s) / step_s)) + _SPARE_STEPS)
    run = moved(state=state, duration_s=steps * step_s, output_positions_m=positions_m)
    if isinstance(run, FailedSimulation):
        return run
    rest_x, rest_y, _ = beam.points(positions_m, modes.equilibrium)
    return SimulatedMotion(
        first_s + run.time_s, run.x_m, run.y_m, run.angle_rad, rest_x, rest_y, matched.axis
    )

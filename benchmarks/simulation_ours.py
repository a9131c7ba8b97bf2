"""modalcam's beam in the benchmark."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.simulation_cases import DAMPING
from sim.beam import AncfBeam, BeamModes
from sim.dynamics import BaseMotion, FailedSimulation, HarmonicThenStop, State, Trajectory, simulate
from tracker import FloatArray


def decay(
    beam: AncfBeam, modes: BeamModes, state: State, step_s: float, duration_s: float, sample_s: float
) -> tuple[float, FloatArray]:
    """CPU seconds of a free decay, and the transverse displacement of the tip.

    Raises
    ------
    ArithmeticError
        If the simulation fails.
    """
    start = time.process_time()
    run = simulate(
        beam,
        DAMPING,
        state=state,
        duration_s=duration_s,
        step_s=step_s,
        output_positions_m=np.array([beam.properties.length_m]),
        output_every=round(sample_s / step_s),
        modes=modes,
    )
    cpu_s = time.process_time() - start
    return cpu_s, _tip(run)


def base_decay(
    beam: AncfBeam,
    modes: BeamModes,
    motion: HarmonicThenStop,
    step_s: float,
    duration_s: float,
    sample_s: float,
) -> tuple[float, FloatArray]:
    """CPU seconds of a run from rest under base motion, and the tip displacement relative to the base."""
    start = time.process_time()
    steps = round(duration_s / step_s)
    run = simulate(
        beam,
        DAMPING,
        state=State(modes.equilibrium, np.zeros(beam.ndof)),
        duration_s=duration_s,
        step_s=step_s,
        output_positions_m=np.array([beam.properties.length_m]),
        base=BaseMotion.sample(motion, step_s, steps),
        output_every=round(sample_s / step_s),
        modes=modes,
    )
    cpu_s = time.process_time() - start
    return cpu_s, _tip(run)


def _tip(run: Trajectory | FailedSimulation) -> FloatArray:
    if isinstance(run, FailedSimulation):
        raise ArithmeticError(run.reason)  # noqa: TRY004 - a result, not a type, is wrong
    return run.transverse_m[:, 0]

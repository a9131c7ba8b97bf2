"""Trials of a plan: its recordings rendered, tracked and identified many times, each with other camera noise."""

from __future__ import annotations

import gzip
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from modal_id import FailedIdentification, Identification, IdentifiedMode, IdentifySettings, identify
from modalcam.execution import TaskFailure, worker_pool
from modalcam.planning.request import PlannedMode, PlanRequest
from modalcam.planning.results import TrialSummary
from sim.beam import AncfBeam, BeamProperties, beam_modes
from sim.damping import GenericDamping
from sim.render import (
    Camera,
    Optics,
    RecordingPlan,
    StagedRecording,
    expose,
    render_ideal,
    stage_recording,
    write_video,
)
from tracker import FloatArray, MarkerTracks, TrackerSettings, displacement_series, track

_MODES_SIMULATED = 8
# Steady vibration before the stop, in cycles and seconds.
_STEADY_CYCLES, _STEADY_S = 8.0, 0.1
# Float32 holds counts of 16 bit to 0.004 of a count.
_STORED = np.dtype("<f4")


@dataclass(frozen=True)
class _MeanFrames:
    """Noise-free frames of one mode as compressed float32 counts in a file, and the camera cropped to the motion.

    Every trial of the mode has the same motion.
    """

    path: Path
    camera: Camera

    def read(self) -> Iterator[FloatArray]:
        """Yield each frame, shape (height_px, width_px)."""
        shape = (self.camera.height_px, self.camera.width_px)
        size = _STORED.itemsize * shape[0] * shape[1]
        with gzip.open(self.path) as file:
            while chunk := file.read(size):
                yield np.frombuffer(chunk, dtype=_STORED).reshape(shape).astype(np.float64)


class _RenderTask(NamedTuple):
    beam: BeamProperties
    mode: PlannedMode
    path: Path


class _TrialTask(NamedTuple):
    beam: BeamProperties
    mode: PlannedMode
    means: _MeanFrames | TaskFailure | str
    seed: tuple[int, ...]


def run_trials(
    request: PlanRequest, trials: int, *, seed: int, jobs: int, done: Callable[[int], None] | None = None
) -> tuple[TrialSummary, ...]:
    """Render, track and identify every planned mode `trials` times, with the same result for any number of jobs."""
    modes = request.modes
    with tempfile.TemporaryDirectory(prefix="modalcam-plan-") as folder, worker_pool(jobs) as pool:
        rendering = [_RenderTask(request.beam, m, Path(folder) / f"{k}.gz") for k, m in enumerate(modes)]
        means = pool.map(_render, rendering, unit="mode")
        tasks = [
            _TrialTask(request.beam, mode, means[index], (seed, index, k))
            for index, mode in enumerate(modes)
            for k in range(trials)
        ]
        results = pool.map(_trial, tasks, done, unit="trial")
    return tuple(
        _summary(mode.number, results[index * trials : (index + 1) * trials])
        for index, mode in enumerate(modes)
    )


def _render(task: _RenderTask) -> _MeanFrames | str:
    """Simulate and render one mode without noise; a reason where the simulation fails."""
    mode = task.mode
    optics = {f.name: getattr(mode.camera, f.name) for f in fields(Optics) if f.name != "fps"}
    frequency = float(beam_modes(AncfBeam(task.beam), mode.number).frequency_hz[-1])
    staged = stage_recording(
        task.beam,
        GenericDamping((mode.damping_ratio,) * mode.number),
        RecordingPlan(
            mode_number=mode.number,
            tip_amplitude_m=1e-3 * mode.tip_amplitude_mm,
            shake_s=max(_STEADY_S, _STEADY_CYCLES / frequency),
            decay_s=mode.decay_length_s(frequency),
        ),
        Optics(fps=Fraction(mode.fps), **optics),
        markers=mode.markers,
        positions_m=1e-3 * np.array(mode.positions_mm),
        mode_count=max(_MODES_SIMULATED, mode.number + 1),
    )
    if not isinstance(staged, StagedRecording):
        return f"the simulation stopped at {staged.time_s:.6g} s: {staged.reason}"
    with gzip.open(task.path, "wb", compresslevel=1) as file:
        for image in render_ideal(staged.scene, staged.camera, staged.frame_times_s):
            file.write(image.astype(_STORED).tobytes())
    return _MeanFrames(task.path, staged.camera)


def _trial(task: _TrialTask) -> IdentifiedMode | str:
    """Add noise to the frames of one mode, track and identify them as `modalcam run` would; a reason where it fails."""
    if not isinstance(task.means, _MeanFrames):
        return _reason(task.means)
    mode = task.mode
    settings = TrackerSettings(
        fps=Fraction(mode.fps),
        mm_per_px=mode.camera.mm_per_px,
        exposure_s=mode.camera.exposure_s or None,
        kind=mode.kind,
        positions_mm=mode.positions_mm,
    )
    with tempfile.TemporaryDirectory(prefix="modalcam-plan-") as folder:
        path = Path(folder) / "take.mkv"
        frames = expose(task.means.read(), task.means.camera, np.random.default_rng(task.seed))
        write_video(path, frames, fps_container=Fraction(30), codec="ffv1")
        tracks = track(path, settings, recording="take")
    if not isinstance(tracks, MarkerTracks):
        return tracks.reason
    theory = beam_modes(AncfBeam(task.beam), _MODES_SIMULATED)
    found = identify(
        displacement_series(tracks),
        IdentifySettings(
            mode=mode.number,
            expected_frequencies_hz=tuple(float(f) for f in theory.frequency_hz),
            expected_shapes=theory.transverse_at(1e-3 * np.array(mode.positions_mm)),
            seed=task.seed[0],
            seed_key=task.seed[1:],
        ),
    )
    if isinstance(found, Identification) and isinstance(found.target, IdentifiedMode):
        return found.target
    return found.reason if isinstance(found, FailedIdentification) else "the mode was not identified"


def _summary(mode: int, results: list[IdentifiedMode | str | TaskFailure]) -> TrialSummary:
    ratios = [r.damping_ratio for r in results if isinstance(r, IdentifiedMode)]
    reasons = [_reason(r) for r in results if not isinstance(r, IdentifiedMode)]
    return TrialSummary(
        mode=mode,
        identified=len(ratios),
        count=len(results),
        damping_spread=float(np.std(ratios, ddof=1)) if len(ratios) >= 3 else float("nan"),
        problems=tuple(dict.fromkeys(reasons)),
    )


def _reason(failure: TaskFailure | str) -> str:
    return failure if isinstance(failure, str) else failure.reason

"""From a configuration to a plan, its trials, and what would narrow its intervals: other positions and frame rates.

A trial renders, tracks and identifies the planned recordings many times, each with other camera noise.
"""

from __future__ import annotations

import gzip
import tempfile
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from modal_id import Identification, IdentifiedMode, IdentifySettings, ModeFlag, identify
from modal_id.modes import apparent_hz
from modalcam.apps.plan.predict import motions, predict
from modalcam.apps.plan.request import (
    BetterPositions,
    FrameRate,
    ModePlan,
    Plan,
    PlannedMode,
    PlanRequest,
    TrialSummary,
    plan_request,
)
from modalcam.common import ConfigError
from modalcam.config import ExperimentConfig, load_config
from modalcam.pipeline import Progress, TaskFailure, worker_pool
from sim.beam import AncfBeam, BeamProperties, BuckledBeamError, NoEquilibriumError, beam_modes
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
from tracker import Failure, FloatArray, MarkerTracks, TrackerSettings, displacement_series, track

_MODES_SIMULATED = 8
# Float32 holds counts of 16 bit to 0.004 of a count.
_STORED = np.dtype("<f4")


@dataclass(frozen=True)
class Tuning:
    """Thresholds of trials and suggestions."""

    #: [cycles] steady vibration before the stop
    #: convention: Chosen, so that the stop is seen.
    steady_cycles: float = 8.0
    #: [s] its least duration
    #: convention: As for the cycles.
    steady: float = 0.1
    #: [1] gain of information on the worst mode for which other positions are suggested
    #: statistics: A tenth less standard deviation: 1.25^-0.5 = 0.89.
    worth_moving: float = 1.25
    #: [1] share of the frame rate below which a mode is sampled well
    #: physics: The exposure attenuates it little, and its harmonics stay separated.
    comfortable: float = 0.4
    #: [cycles] distance of the apparent frequency of a mode from 0, half the rate and other modes, over the record
    #: convention: Twenty lines of the spectrum of the record.
    cycles_apart: float = 20.0


TUNING = Tuning()


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
    means: _MeanFrames | TaskFailure | Failure
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


def _render(task: _RenderTask) -> _MeanFrames | Failure:
    """Simulate and render one mode without noise."""
    mode = task.mode
    optics = {f.name: getattr(mode.camera, f.name) for f in fields(Optics) if f.name != "fps"}
    frequency = float(beam_modes(AncfBeam(task.beam), mode.number).frequency_hz[-1])
    staged = stage_recording(
        task.beam,
        GenericDamping((mode.damping_ratio,) * mode.number),
        RecordingPlan(
            mode_number=mode.number,
            tip_amplitude_m=1e-3 * mode.tip_amplitude_mm,
            shake_s=max(TUNING.steady, TUNING.steady_cycles / frequency),
            decay_s=mode.decay_length_s(frequency),
        ),
        Optics(fps=Fraction(mode.fps), **optics),
        markers=mode.markers,
        positions_m=1e-3 * np.array(mode.positions_mm),
        mode_count=max(_MODES_SIMULATED, mode.number + 1),
    )
    if not isinstance(staged, StagedRecording):
        return Failure(f"the simulation stopped at {staged.time_s:.6g} s: {staged.reason}")
    with gzip.open(task.path, "wb", compresslevel=1) as file:
        for image in render_ideal(staged.scene, staged.camera, staged.frame_times_s):
            file.write(image.astype(_STORED).tobytes())
    return _MeanFrames(task.path, staged.camera)


def _trial(task: _TrialTask) -> IdentifiedMode | Failure:
    """Add noise to the frames of one mode, track and identify them as `modalcam run` would."""
    if not isinstance(task.means, _MeanFrames):
        return Failure(task.means.reason)
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
        return Failure(tracks.reason)
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
    target = found.target if isinstance(found, Identification) else found
    if isinstance(target, IdentifiedMode):
        # which of the possible frequencies is the true one is known here
        wrong = ", ".join(flag for flag in target.wrong_flags if flag != ModeFlag.ALIASED_POSSIBLE.name)
        return Failure(f"flagged {wrong}: its values may be wrong") if wrong else target
    return Failure("the mode was not identified" if target is None else target.reason)


def _summary(mode: int, results: list[IdentifiedMode | Failure | TaskFailure]) -> TrialSummary:
    ratios = [r.damping_ratio for r in results if isinstance(r, IdentifiedMode)]
    reasons = [r.reason for r in results if not isinstance(r, IdentifiedMode)]
    return TrialSummary(
        mode=mode,
        identified=len(ratios),
        count=len(results),
        damping_spread=float(np.std(ratios, ddof=1)) if len(ratios) >= 3 else float("nan"),
        problems=tuple(dict.fromkeys(reasons)),
    )


_GRID = 101
# Rates that high-speed cameras offer.
_RATES = np.array(
    [60, 120, 240, 250, 400, 500, 600, 800, 1000, 1200, 1500, 2000, 2500, 3000, 4000, 5000, 7500, 1e4, 2e4]
)


def better_positions(request: PlanRequest) -> tuple[BetterPositions, ...]:
    """Better positions for each group of modes that is filmed with the same markers; none where there are no better.

    Information on a mode grows with the sum of its squared shape over the markers. Positions are chosen one by one
    and then exchanged to maximise the information on the worst mode, relative to its motion at the tip. Prints do not
    touch, stay on the beam, and keep half the distance of even spacing, so that they resolve the mode shape too.
    """
    groups: dict[Hashable, list[PlannedMode]] = {}
    for mode in request.modes:
        groups.setdefault((mode.positions_mm, mode.markers), []).append(mode)
    found = (_better(replace(request, modes=tuple(modes))) for modes in groups.values())
    return tuple(positions for positions in found if positions is not None)


def _better(request: PlanRequest) -> BetterPositions | None:
    first, length_mm = request.modes[0], 1e3 * request.beam.length_m
    reach = max(p.half_extent_mm for p in first.markers)
    inset = min(reach, 0.5 * length_mm)
    grid = np.linspace(inset, length_mm - inset, _GRID)
    power = _power(request, grid)
    count = len(first.positions_mm)
    chosen = _exchange(power, grid, count, max(2.0 * reach, 0.5 * length_mm / count))
    if chosen is None:
        return None
    now = _power(request, np.array(first.positions_mm)).sum(axis=0)
    if power[chosen].sum(axis=0).min() <= TUNING.worth_moving * now.min():
        return None
    positions = tuple(round(float(p), 1) for p in np.sort(grid[chosen]))
    moved = replace(request, modes=tuple(replace(m, positions_mm=positions) for m in request.modes))
    before, after = predict(request), predict(moved)
    factors = tuple(b.damping_sd / a.damping_sd for a, b in zip(before, after, strict=True))
    return BetterPositions(tuple(m.number for m in request.modes), positions, factors)


def _power(request: PlanRequest, positions_mm: FloatArray) -> FloatArray:
    """Squared shapes relative to the tip, shape (k, planned modes)."""
    return np.column_stack([way.shape**2 for way in motions(request, positions_mm)])


def _exchange(power: FloatArray, grid_mm: FloatArray, count: int, apart_mm: float) -> list[int] | None:
    """Grid points chosen one by one, then exchanged while that helps the worst mode; None where they do not fit."""
    chosen: list[int] = []
    for _ in range(count):
        best = _best_addition(power, grid_mm, chosen, apart_mm)
        if best is None:
            return None
        chosen.append(best)
    for _ in range(10 * count):
        worth = power[chosen].sum(axis=0).min()
        for k in range(count):
            others = chosen[:k] + chosen[k + 1 :]
            best = _best_addition(power, grid_mm, others, apart_mm)
            if best is not None and power[[*others, best]].sum(axis=0).min() > worth * (1.0 + 1e-9):
                chosen = [*others, best]
                break
        else:
            break
    return chosen


def _best_addition(power: FloatArray, grid_mm: FloatArray, chosen: list[int], apart_mm: float) -> int | None:
    free = np.ones(grid_mm.size, dtype=bool)
    for k in chosen:
        free &= np.abs(grid_mm - grid_mm[k]) >= apart_mm
    if not free.any():
        return None
    total = power[chosen].sum(axis=0) if chosen else np.zeros(power.shape[1])
    # The worst mode decides; the sum breaks ties.
    worth = (total + power).min(axis=1) + 1e-6 * power.sum(axis=1)
    return int(np.argmax(np.where(free, worth, -1.0)))


def frame_rates(modes: tuple[ModePlan, ...]) -> tuple[FrameRate, ...]:
    """Sufficient frame rate of each group of modes filmed at one rate, and a lower one at which aliases stay apart."""
    out = []
    for fps in dict.fromkeys(m.planned.fps for m in modes):
        group = tuple(m for m in modes if m.planned.fps == fps)
        highest = max(m.frequency_hz for m in group)
        slow = [r for r in _RATES.tolist() if r < 2.0 * highest and _all_apart(r, group)]
        full = next((r for r in _RATES.tolist() if highest < TUNING.comfortable * r), None)
        out += [_rate(r, group) for r in (*slow[-1:], full) if r is not None]
    return tuple(out)


def _rate(fps: float, modes: tuple[ModePlan, ...]) -> FrameRate:
    frequency = [m.frequency_hz for m in modes]
    seen = tuple(apparent_hz(f, fps) for f in frequency)
    return FrameRate(tuple(m.number for m in modes), fps, seen, max(frequency) > 0.5 * fps)


def _all_apart(fps: float, modes: tuple[ModePlan, ...]) -> bool:
    seen = _rate(fps, modes).seen_hz
    for k, (own, mode) in enumerate(zip(seen, modes, strict=True)):
        others = [0.0, 0.5 * fps, *seen[:k], *seen[k + 1 :]]
        if min(abs(own - o) for o in others) * mode.decay_s < TUNING.cycles_apart:
            return False
    return True


def plan(
    config: ExperimentConfig | Path | str,
    *,
    trials: int = 0,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Plan:
    """Predict the intervals of an experiment before it is filmed.

    Parameters
    ----------
    config : ExperimentConfig, Path or str
        Configuration, or path of an `experiment.toml`. It needs `[beam]`, camera.fps, camera.mm_per_px and
        markers.positions_mm; rate, scale and markers may be given per recording instead.
    trials : int
        Recordings to render, track and identify for each mode; their scatter checks the prediction.
    seed : int
        Of the camera noise in the trials.
    jobs : int
        Worker processes for the trials; the result does not depend on it.
    progress : Progress or None
        Of the trials.

    Returns
    -------
    Plan

    Raises
    ------
    ConfigError
        If the configuration cannot be read or lacks a key, if the beam buckles or cannot carry its weight, if its mesh
        has too few modes, or if a number is one that no experiment has.

    Examples
    --------
    >>> import modalcam as mc
    >>> expected = mc.plan("sample_videos/experiment.toml").to_dataframe()
    >>> expected["frequency_hz"].round(2).tolist()
    [1.88, 10.58, 29.26, 57.15, 94.34]
    """
    source = "configuration" if isinstance(config, ExperimentConfig) else str(config)
    if not isinstance(config, ExperimentConfig):
        config = load_config(Path(config))
    request = plan_request(config, source)
    try:
        modes = predict(request)
        positions = better_positions(request)
    except (ValueError, BuckledBeamError, NoEquilibriumError) as error:
        msg = f"{source}: {error}"
        raise ConfigError(msg) from error
    found = Plan(request, modes, positions, frame_rates(modes))
    if not trials:
        return found
    if progress is not None:
        progress.begin("running trials", trials * len(modes))

    def done(k: int) -> None:
        if progress is not None:
            progress.advance(f"trial {k + 1}")

    return replace(found, trials=run_trials(request, trials, seed=seed, jobs=jobs, done=done))

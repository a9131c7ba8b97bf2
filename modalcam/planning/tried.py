"""What trying a plan out showed, beside what was predicted."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modalcam.execution.pool import TaskFailure, worker_pool
from modalcam.planning.means import MeanFrames, film_means
from modalcam.planning.request import PlanRequest
from modalcam.planning.simulate import Trial, failed_trial, try_out


@dataclass(frozen=True)
class Tried:
    """All trials of one mode.

    Attributes
    ----------
    mode : int
    identified, asked : int
        Trials that gave the mode, and all.
    damping_spread, frequency_spread_hz : float
        Standard deviations over the trials; NaN below three.
    stated_damping_sd, stated_frequency_sd_hz : float
        Medians of what each identification stated.
    problems : tuple of str
        Why trials gave nothing, each reason once.
    """

    mode: int
    identified: int
    asked: int
    damping_spread: float
    frequency_spread_hz: float
    stated_damping_sd: float
    stated_frequency_sd_hz: float
    problems: tuple[str, ...]


@dataclass(frozen=True)
class _Task:
    request: PlanRequest
    index: int
    folder: Path


@dataclass(frozen=True)
class _TrialTask:
    request: PlanRequest
    index: int
    means: MeanFrames | TaskFailure | str
    seed: tuple[int, ...]


def try_all(
    request: PlanRequest, trials: int, *, seed: int, jobs: int, done: Callable[[int], None] | None = None
) -> tuple[Tried, ...]:
    """Render, track and identify every planned mode `trials` times; the same for any number of jobs.

    The motion of a mode is rendered once: its recordings differ by the camera's noise.
    """
    indices = range(len(request.modes))
    with tempfile.TemporaryDirectory(prefix="modalcam-plan-") as folder, worker_pool(jobs) as pool:
        means = pool.map(_film, [_Task(request, index, Path(folder)) for index in indices])
        tasks = [
            _TrialTask(request, index, means[index], (seed, index, k))
            for index in indices
            for k in range(trials)
        ]
        results = pool.map(_run, tasks, done)
    return tuple(
        _tried(mode.number, results[index * trials : (index + 1) * trials])
        for index, mode in enumerate(request.modes)
    )


def _film(task: _Task) -> MeanFrames | str:
    return film_means(task.request, task.index, task.folder / f"mode-{task.index}.gz")


def _run(task: _TrialTask) -> Trial:
    if isinstance(task.means, MeanFrames):
        return try_out(task.request, task.index, task.means, task.seed)
    reason = task.means.reason if isinstance(task.means, TaskFailure) else task.means
    return failed_trial(task.request.modes[task.index].number, reason)


def _tried(mode: int, results: list[Trial | TaskFailure]) -> Tried:
    good = [r for r in results if isinstance(r, Trial) and not r.problem]
    reasons = [r.reason if isinstance(r, TaskFailure) else r.problem for r in results]
    zeta = np.array([r.damping_ratio for r in good])
    frequency = np.array([r.frequency_hz for r in good])
    enough = len(good) >= 3
    nan = float("nan")
    return Tried(
        mode=mode,
        identified=len(good),
        asked=len(results),
        damping_spread=float(zeta.std(ddof=1)) if enough else nan,
        frequency_spread_hz=float(frequency.std(ddof=1)) if enough else nan,
        stated_damping_sd=float(np.median([r.damping_sd for r in good])) if good else nan,
        stated_frequency_sd_hz=float(np.median([r.frequency_sd_hz for r in good])) if good else nan,
        problems=tuple(dict.fromkeys(r for r in reasons if r)),
    )

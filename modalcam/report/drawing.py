"""Figures of the report, drawn in the worker processes of a run before the report is written."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from modalcam.execution import Progress, WorkerPool
from modalcam.pipeline import RunResult
from modalcam.report.build import shown_figures
from modalcam.report.figures import FIGURES
from modalcam.storage import Cache


@dataclass(frozen=True)
class _Task:
    kind: str
    shown: Any
    folder: Path
    key: str


def draw_figures(
    result: RunResult, folder: Path, pool: WorkerPool, progress: Progress, meanwhile: Iterator[object]
) -> None:
    """Draw the figures of the report of `result` that `folder`, where they are kept, does not hold.

    This process takes steps of `meanwhile` until they are drawn.
    """
    kept = Cache(folder)
    tasks: dict[str, _Task] = {}
    for kind, shown in shown_figures(result):
        key = kind.cache_key(shown)
        if not kept.holds(key):
            tasks[key] = _Task(kind.key, shown, folder, key)
    if not tasks:
        return
    names = [task.kind for task in tasks.values()]
    progress.begin("drawing", len(names))
    pool.map(
        _draw,
        list(tasks.values()),
        done=lambda at: progress.advance(names[at]),
        meanwhile=meanwhile,
        unit="figure",
    )


def _draw(task: _Task) -> None:
    kind = FIGURES.get(task.kind)
    # What a worker would draw otherwise, such as with another matplotlib, is left to the process that asks for it.
    if kind is not None and kind.cache_key(task.shown) == task.key:
        kind.svg(task.shown, Cache(task.folder))

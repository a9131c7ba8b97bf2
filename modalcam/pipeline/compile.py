"""Compilation of the kernels before the first stage: each by one process, instead of by all that meet it.

numba keeps what it compiles beside the source, or in the user's cache folder where that is read-only, for each version
of the source and each processor. A kernel that another one calls is compiled with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
from filelock import FileLock

from modalcam.pipeline.pool import TaskFailure, WorkerPool
from modalcam.pipeline.results import RecordingResult
from modalcam.pipeline.stage import Context, Progress

STAGE = "compiling, first run on this machine"


@dataclass(frozen=True)
class Group:
    """Kernels that one process compiles.

    Attributes
    ----------
    compiling : str
        Module and function, which calls a public entry point with little data.
    called : tuple of str
        The kernels that Python calls in a run, with their modules: all are compiled when each of these is.
    """

    compiling: str
    called: tuple[str, ...]


# Those that take longest first.
MARKERS = Group(
    "tracker.compile:compile_for_markers",
    (
        "tracker.register.kernel:make_workspace",
        "tracker.register.kernel:register",
        "tracker.register.kernel:correlation",
        "tracker.register.kernel:acceptable",
        "tracker.template.template:_add_frame",
        "tracker.template.template:_solve",
        "tracker.template.spline:placed",
        "tracker.template.spline:_fill_modelled",
        "tracker.follow.fits:follow_plain",
        "tracker.follow.fits:all_plain",
        "tracker.follow.fits:store_fits",
        "tracker.follow.predict:predict_all",
        "tracker.follow.predict:update_all",
        "tracker.register.poor_fit:reconsider",
    ),
)
LINES = Group(
    "tracker.compile:compile_for_lines",
    (
        "tracker.line.follower:best_path",
        "tracker.line.stations:place_stations",
        "tracker.line.profile:add_to_profile",
        "tracker.line.kernel:polynomials_of",
        "tracker.line.kernel:register_line",
        "tracker.line.stations:weighted",
        "tracker.line.stations:at_stations",
        "tracker.line.stations:register_about",
        "tracker.line.stations:moved",
        "tracker.line.stations:judge_predictions",
        "tracker.line.stations:learn_recursion",
        "tracker.line.stations:path_along_normals",
        "tracker.line.model:_add",
    ),
)
SIMULATION = Group(
    "sim.compile:compile_for_simulations", ("sim.beam.elastic:elastic", "sim.dynamics.march:march")
)
DECAYS = Group(
    "modal_id.compile:compile_for_decays",
    (
        "modal_id.solve.weighting:_add_normal",
        "modal_id.solve.linear:_subtract",
        "modal_id.data.baseline:_cubic",
        "modal_id.fit.amplitude_dependence:_decay",
        "modal_id.posterior.reduction:chi_square_of",
        "modal_id.curve.law_fit:_slopes",
    ),
)
DIVISION = Group("modal_id.compile:compile_for_division", ("modal_id.segments.partition:stretch_costs",))
FILMS = Group(
    "sim.compile:compile_for_films", ("sim.render.kernels:add_marker", "sim.render.kernels:add_strip")
)
GROUPS = (LINES, MARKERS, SIMULATION, DIVISION, DECAYS, FILMS)


def compile_for(
    context: Context, recordings: Sequence[RecordingResult], *, tracking_only: bool = False
) -> None:
    """Compile what these recordings need, with `tracking_only` up to their tracks."""
    films = [r for r in recordings if r.sha256 and r.path is not None and r.tracks is None]
    kinds = {context.config.for_recording(film.file).kind for film in films}
    groups = [LINES] if "line" in kinds else []
    groups += [MARKERS] if kinds - {"line"} else []
    beam = context.config.beam
    if not tracking_only:
        groups += [SIMULATION] if beam is not None and not beam.missing() else []
        groups += [DIVISION, DECAYS]
        groups += [FILMS] if SIMULATION in groups and films else []
    compile_kernels(context.pool, context.progress, groups)


def compile_kernels(pool: WorkerPool, progress: Progress, groups: Iterable[Group] = GROUPS) -> None:
    """Compile what is missing of the groups in the processes of `pool`; nothing is shown where nothing is missing.

    A group that fails is compiled by the tasks that need it, as far as they can. Nothing is compiled for the machines
    of a cluster, each of which may have another processor.
    """
    todo = [group for group in groups if missing(group)] if pool.on_this_machine else []
    if not todo:
        return
    left = [kernel for group in todo for kernel in missing(group)]
    progress.begin(STAGE, len(left))

    def look() -> None:
        for kernel in [kernel for kernel in left if is_compiled(kernel)]:
            left.remove(kernel)
            progress.advance("")

    for outcome in pool.map(_compile, todo, look=look, unit="compilation"):
        if isinstance(outcome, TaskFailure):
            progress.say(f"compiling failed: {outcome.reason}")
    look()


def missing(group: Group) -> list[str]:
    """The called kernels of a group that are not compiled."""
    return [kernel for kernel in group.called if not is_compiled(kernel)]


def is_compiled(kernel: str) -> bool:
    """Whether numba has kept a kernel, of its present source and for this processor."""
    dispatcher = _function(kernel)
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]  # set when numba is loaded
        return True
    processor = dispatcher.targetctx.codegen().magic_tuple()
    # numba itself tells only by compiling.
    index = dispatcher._cache._cache_file._load_index()  # noqa: SLF001
    return any(key[1] == processor for key in index)


def _compile(group: Group) -> None:
    """Compile a group, in a worker, unless another command on this machine has just done so.

    Two processes must not: numba numbers the files of a kernel without a lock, so that the code of one set of arguments
    could be kept under the name of another.
    """
    with FileLock(Path(_function(group.called[0]).stats.cache_path) / "modalcam-kernels.lock"):
        if missing(group):
            _function(group.compiling)()
        if left := missing(group):
            msg = f"{group.compiling} does not call {', '.join(left)}"
            raise RuntimeError(msg)


def _function(name: str) -> Any:
    module, _, function = name.partition(":")
    return getattr(import_module(module), function)

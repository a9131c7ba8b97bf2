"""`modalcam paper`: a run, the paper's tables computed again, and the page of both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from modalcam.commands import Options, run
from modalcam.execution.pool import TaskFailure, worker_pool
from modalcam.execution.progress import Progress
from modalcam.paper.page import PaperInput, PaperPage, paper_html, paper_page
from modalcam.paper.recomputed import Recomputed, recompute
from modalcam.paper.truth import read_truth
from modalcam.pipeline.results import RunResult
from modalcam.storage.atomic import write_text
from modalcam.storage.cache import load, save
from modalcam.storage.output_folder import Workspace
from modalcam.storage.provenance import code_sha256, stage_key, versions

# A name that no recording has: theirs never begin with a dot.
_STATE = ".paper"


@dataclass(frozen=True)
class Made:
    """The run and its page."""

    result: RunResult
    page: PaperPage


def make_paper(folder: Path, options: Options, progress: Progress) -> Made:
    """Take a folder through all stages as `modalcam run` does, then write OUT/paper.html.

    Raises
    ------
    ModalcamError
        As `modalcam run` does.
    """
    result = run(folder, options, progress)
    workspace = Workspace(options.out)
    with workspace.locked():
        paper = _recomputed(workspace.state(_STATE, "recomputed"), options, progress)
        page = paper_page(PaperInput(result, paper, read_truth(folder)))
        write_text(workspace.paper, paper_html(page))
    return Made(result, page)


def _recomputed(saved: Path, options: Options, progress: Progress) -> Recomputed:
    """The paper's numbers computed again, or as saved by the same code.

    Raises
    ------
    RuntimeError
        If the computation, which has no input, failed: a fault of the program.
    """
    progress.begin("recomputing the paper", 1)
    key = stage_key("paper", code=(code_sha256("sim", "modalcam"), versions()))
    found = None if options.force else load(saved, key)
    if isinstance(found, Recomputed):
        progress.advance("paper")
        return found
    # A process of its own, so that linear algebra has one thread and the same round-off everywhere.
    with worker_pool(1) as pool:
        value = pool.map(_recompute, [None])[0]
    if not isinstance(value, TaskFailure):
        save(saved, key, value)
        progress.advance("paper")
        return value
    raise RuntimeError(value.reason)


def _recompute(_: None) -> Recomputed:
    return recompute()

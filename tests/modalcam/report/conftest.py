"""Reports built once for all workers, with one cache of figures for all tests."""

from functools import partial

import pytest
from support import report_runs as runs

from modalcam.pipeline import Cache, load, save
from modalcam.report import build_report


@pytest.fixture(scope="session")
def build(shared_folder):
    """Builds reports; figures drawn by other tests, in any worker, are reused."""
    return partial(build_report, cache=Cache(shared_folder("figures", lambda _: None)))


@pytest.fixture(scope="session")
def paper(shared_folder, build):
    """Five recordings, compared and updated, and their report."""

    def fill(folder):
        recordings = runs.compared(runs.paper_recordings())
        result = runs.run_result(recordings, beam=runs.beam_result(), not_done=("the beam was not weighed",))
        save(folder / "run.npz", "", result)
        (folder / "report.html").write_text(build(result), encoding="utf-8")

    folder = shared_folder("paper_report", fill)
    return load(folder / "run.npz"), (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def paper_run(paper):
    return paper[0]


@pytest.fixture(scope="session")
def paper_html(paper):
    return paper[1]


@pytest.fixture(scope="session")
def hostile_html(build):
    """The report of a run with every hostile name as file, as marker and in every text."""
    return build(runs.hostile_run())

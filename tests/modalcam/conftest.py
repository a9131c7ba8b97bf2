"""What apps add to a run, reports built once for all workers with one cache of figures, and a browser."""

from functools import partial

import pytest


@pytest.fixture(scope="session", autouse=True)
def _apps():
    # most test files of other packages need none of it
    from modalcam.plugins import load_apps

    load_apps("plugin")


@pytest.fixture(scope="session")
def build(shared_folder):
    """Builds reports; figures drawn by other tests, in any worker, are reused."""
    from modalcam.pipeline import Cache
    from modalcam.report import build_report

    return partial(build_report, cache=Cache(shared_folder("figures", lambda _: None)))


@pytest.fixture(scope="session")
def paper(shared_folder, build):
    """Five recordings, compared and updated, and their report."""
    from kit import runs

    from modalcam.pipeline import load, save

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
    from kit import runs

    return build(runs.hostile_run())


@pytest.fixture(scope="module")
def browser():
    from support.browser import chromium

    with chromium() as started:
        yield started


@pytest.fixture
def opened(browser, tmp_path):
    """Opens a report and returns its page."""
    from support.browser import opening

    with opening(browser, tmp_path / "report.html") as open_report:
        yield open_report

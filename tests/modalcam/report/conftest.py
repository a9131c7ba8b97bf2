"""Reports built once per session, with one cache of figures for all tests."""

from functools import partial

import pytest

from modalcam.report.build import build_report
from modalcam.storage.cache import Cache


@pytest.fixture(scope="session")
def build(tmp_path_factory):
    """Builds reports; figures drawn by other tests are reused."""
    return partial(build_report, cache=Cache(tmp_path_factory.mktemp("figures")))

"""What apps add to a run is there in all tests of the application, as in every process of a run."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def _apps():
    # most test files of other packages need none of it
    from modalcam.plugins import load_apps

    load_apps("plugin")

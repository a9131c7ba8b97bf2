"""Planning requests for the tests."""

import pytest
from kit.beams import BEAM

from modalcam.apps.plan import plan_request
from modalcam.config import ExperimentConfig


def request_of(camera=None, markers=None, plan=None, recordings=()):
    dots = {"kind": "blob", "size_mm": 20.0, "positions_mm": [190.0, 390.0, 480.0]}
    config = {
        "camera": {"fps": 500, "mm_per_px": 2.0} | (camera or {}),
        "markers": dots | (markers or {}),
        "beam": BEAM,
        "plan": {"modes": [2, 3]} | (plan or {}),
        "recordings": recordings,
    }
    return plan_request(ExperimentConfig.model_validate(config), "experiment.toml")


@pytest.fixture
def plan_of():
    """``plan_of(camera, markers, plan, recordings)``: a request with these keys, for a beam with three dots."""
    return request_of

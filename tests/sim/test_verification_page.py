"""The values in docs/studies/verification.md match the computed ones."""

import importlib.util
import re
import sys

import pytest
from support.paths import ROOT

PAGE = ROOT / "docs" / "studies" / "verification.md"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("verification", PAGE.with_suffix(".py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules["verification"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "part",
    [
        "statics",
        "small_vibration",
        "order_in_time",
        # fast: large motion against the same references in dynamics/test_simulate.py
        pytest.param("large_motion", marks=pytest.mark.slow),
    ],
)
def test_page_prints_the_computed_values(script, part):
    text = PAGE.read_text(encoding="utf-8")
    for figure in getattr(script, part)():
        row = re.search(rf"^\| {re.escape(figure.name)} \| (\S+) \| (\S*) \|$", text, re.MULTILINE)
        assert row, f"the page has no row {figure.name!r}; run python docs/studies/verification.py"
        printed = float(row[1])
        near = 1.0 / figure.spread <= figure.value / printed <= figure.spread
        assert near, f"{figure.name}: {printed} on the page, computed {figure.value:.4g}"
        if figure.bound is not None:
            assert float(row[2]) == figure.bound
            assert figure.value <= figure.bound, f"{figure.name}: {figure.value:.3g} exceeds {figure.bound}"


def test_page_has_only_computed_rows(script):
    text = PAGE.read_text(encoding="utf-8")
    rows = text.split("<!-- table -->")[1].split("<!-- end of table -->")[0].strip().splitlines()[2:]
    assert len(rows) == 29

"""The values in docs/studies/verification.md match the computed ones."""

import re

import pytest
from support.paths import ROOT, script

PAGE = ROOT / "docs" / "studies" / "verification.md"


@pytest.fixture(scope="module")
def study():
    return script(PAGE.with_suffix(".py"))


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
def test_page_prints_the_computed_values(study, part):
    text = PAGE.read_text(encoding="utf-8")
    for figure in getattr(study, part)():
        row = re.search(rf"^\| {re.escape(figure.name)} \| (\S+) \| (\S*) \|$", text, re.MULTILINE)
        assert row, f"the page has no row {figure.name!r}; run python docs/studies/verification.py"
        printed = float(row[1])
        near = 1.0 / figure.spread <= figure.value / printed <= figure.spread
        assert near, f"{figure.name}: {printed} on the page, computed {figure.value:.4g}"
        if figure.bound is not None:
            assert float(row[2]) == figure.bound
            assert figure.value <= figure.bound, f"{figure.name}: {figure.value:.3g} exceeds {figure.bound}"


def test_page_has_only_computed_rows(study):
    text = PAGE.read_text(encoding="utf-8")
    rows = text.split("<!-- table -->")[1].split("<!-- end of table -->")[0].strip().splitlines()[2:]
    assert len(rows) == 29

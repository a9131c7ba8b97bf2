"""The page on real strips: its numbers follow from the frequencies that it prints, and the clamp is named."""

import pytest
from support.paths import ROOT, script

PAGE = ROOT / "docs" / "studies" / "material.md"


@pytest.fixture(scope="module")
def study():
    return script(PAGE.with_suffix(".py"))


@pytest.fixture(scope="module")
def strips(study):
    """The strips, from the frequencies on the page."""
    lengths = {}
    for row in study.rows_of(PAGE.read_text(encoding="utf-8"), "strips")[1:]:
        value, sd = map(float, row[2].split(" ± "))
        lengths.setdefault(float(row[0]), []).append(study.Measured(f"mode {row[1]}", value, sd))
    return {length: study.strip(length, *modes) for length, modes in lengths.items()}


def test_the_page_prints_the_computed_values(study, strips):
    text = PAGE.read_text(encoding="utf-8")
    assert study.rows_of(text, "strips") == study.rows_of_strips(strips)
    assert study.rows_of(text, "clamp") == study.hidden_length(strips)
    assert study.rows_of(text, "samples") == study.rows_of_samples()


def test_the_clamp_of_the_strips_is_the_suspect(strips):
    """Handbook 70 GPa; the cantilever study finds a clamp as compliant as 4 to 10 mm of strip."""
    assert sorted(strips) == [300.0, 400.0, 500.0]
    for found in strips.values():
        moduli = [v for v in found.values if v.quantity == "E_corrected"]
        assert all(v.q95 < 70.0 for v in moduli)
        assert any("The clamp is rigid" in c.text and c.state == "not known" for c in found.conditions)
    shortest, longest = (
        {v.mode: v.value for v in strips[length].values if v.quantity == "E_corrected"}
        for length in (300.0, 500.0)
    )
    assert all(shortest[n] < longest[n] for n in (1, 2)), "a compliant clamp lowers E of the short strip most"

"""True values of a folder of simulated recordings, and differences of its beam from the paper's."""

from dataclasses import replace

import pytest

from modalcam.apps.paper import beam_differences, read_truth
from sim import paper_beam
from sim.beam import PointMass


@pytest.mark.parametrize("text", ["{", "[]", '{"recordings": [{"mode": 1}]}', '{"recordings": 3}'])
def test_an_unusable_truth_is_reported_and_ignored(tmp_path, text):
    assert read_truth(tmp_path) == {}
    (tmp_path / "truth.json").write_text(text)
    truth = read_truth(tmp_path)
    assert not truth
    assert truth.reason.startswith("truth.json was not used: expected a list of recordings")


def test_differences_from_the_papers_beam_are_listed():
    assert beam_differences(paper_beam()) == ()
    other = replace(paper_beam("standing"), density_kg_m3=7850.0, point_masses=(PointMass(0.4, 5e-4),))
    assert beam_differences(other) == (
        "density 7850 kg/m³ instead of 8000",
        "standing instead of hanging",
        "0.5 g of added mass",
    )

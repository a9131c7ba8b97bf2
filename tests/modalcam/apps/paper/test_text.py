"""Numbers in sentences."""

from types import SimpleNamespace

import numpy as np

from modalcam.apps.paper import error, numbered, of_all, percent_range, signed_percent, signed_range, within
from modalcam.apps.paper import templates as paper_templates


def test_lists_and_counts():
    assert [of_all(n, 5) for n in (0, 2, 5)] == ["none of 5", "2 of 5", "all 5"]
    assert [numbered(n, "mode") for n in ([3], [1, 2], [3, 4, 5], [1, 3])] == [
        "mode 3",
        "modes 1 and 2",
        "modes 3 to 5",
        "modes 1 and 3",
    ]


def test_odds_beyond_the_largest_number_are_infinite():
    assert paper_templates().from_string("{{ 800.0|exponential|significant(2) }}").render() == "∞"


def test_percentages():
    assert signed_percent(0.0123) == "+1.2 %"
    assert signed_percent(float("nan")) == "–"
    assert signed_range([-0.03, float("nan"), 0.01]) == "−3.0 to +1.0 %"
    assert signed_range([]) == "–"
    assert percent_range([-0.03, 0.01]) == "1.0 to 3.0 %"
    assert [within(r) for r in (1e-9, [-0.02, 0.01], float("nan"))] == ["0.0001 %", "2.0 %", "–"]
    assert [error(r) for r in (-1e-9, -0.02)] == ["< 0.0001 %", "−2.0 %"]


def test_variables_at_their_bound_are_named_in_ranges():
    def update(density=1.0, **at):
        width = np.ones(20)
        width[at.get("elements", [])] = 1.1
        names = ("",) * (len(at.get("elements", [])) + (density != 1.0))
        fields = {
            "at_bound": names,
            "width_factor": width,
            "thickness_factor": np.ones(20),
            "elastic_modulus_factor": 1.0,
        }
        return SimpleNamespace(bound=0.1, density_factor=density, **fields)

    bound = paper_templates().get_template("bound.html.j2").module
    assert bound.at_bound(update(0.9, elements=[1, 2, 3, 8])) == (
        "5 of them end at the bound: density at −10 % and width of elements 2 to 4 and 9 at +10 %"
    )
    assert bound.at_bound(update()) == "none of them ends at the bound"
    assert bound.at_bound(update(elements=[0])) == "1 of them ends at the bound: width of element 1 at +10 %"

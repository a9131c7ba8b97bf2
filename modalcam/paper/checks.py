"""The paper's claims, each with its verdict for these numbers."""

from __future__ import annotations

from collections.abc import Sequence
from html import unescape
from typing import NamedTuple

import jinja2
import numpy as np

from modalcam.paper import decays, table2
from modalcam.paper.recomputed import HANDBOOK_DENSITY_KG_M3, Recomputed
from modalcam.paper.text import FILTERS
from modalcam.report.style import environment
from sim import reference as printed


class Check(NamedTuple):
    """One claim: where the page has its numbers, whether it "holds", "does not hold" or was "not checked", and why."""

    anchor: str
    verdict: str
    claim: str
    finding: str

    @property
    def holds(self) -> bool | None:
        """None if the folder has nothing to check it with."""
        return {"holds": True, "does not hold": False}.get(self.verdict)

    @property
    def state(self) -> str:
        """Class of the line on the page."""
        return {"holds": "good", "does not hold": "care"}.get(self.verdict, "none")


def checks(table: Sequence[table2.Row], shown: Sequence[decays.Row], paper: Recomputed) -> tuple[Check, ...]:
    """All claims, in the paper's order."""
    text = templates().get_template("checks.txt.j2").render(table=table, shown=shown, **numbers_of(paper))
    return tuple(Check(*unescape(line).split(" | ")) for line in text.splitlines() if line)


def templates() -> jinja2.Environment:
    """Templates of the page and of the checks."""
    made = environment(("modalcam.paper", "templates"))
    made.filters |= {text_filter.__name__: text_filter for text_filter in FILTERS}
    return made


def numbers_of(paper: Recomputed) -> dict[str, object]:
    """The paper's numbers as the templates name them."""
    return {
        "paper": paper,
        "printed": printed,
        "handbook": HANDBOOK_DENSITY_KG_M3,
        "standard": np.array(printed.TABLE_3_STANDARD_HZ),
        "optimum": np.array(printed.TABLE_3_OPTIMUM_HZ),
        "test": np.array(printed.TABLE_3_TEST_HZ),
    }

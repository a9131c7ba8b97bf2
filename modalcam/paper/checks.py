"""What of the paper holds for these numbers, each in one line with its verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modalcam.paper import decays, table2
from modalcam.paper.recomputed import HANDBOOK_DENSITY_KG_M3, Recomputed
from modalcam.paper.words import largest, listed, modes_named, of_all, signed_range, within
from modalcam.report.style.format import percent
from sim.reference import paper_tables as printed

# How near a column of Table 3 has to come to count as reproduced.
TOLERANCE = 1e-3


@dataclass(frozen=True)
class Check:
    """One claim; `holds` is None where the folder has nothing to check it with."""

    anchor: str
    claim: str
    finding: str
    holds: bool | None

    @property
    def state(self) -> str:
        """Class of the line in the page."""
        return "none" if self.holds is None else "good" if self.holds else "care"

    @property
    def verdict(self) -> str:
        """In one or two words."""
        return "not checked" if self.holds is None else "holds" if self.holds else "does not hold"


def checks(table: Sequence[table2.Row], shown: Sequence[decays.Row], paper: Recomputed) -> tuple[Check, ...]:
    """All claims, in the paper's order."""
    truth = _truth(table)
    return (
        _within("damping ratios", "table-2", [(r.number, r.damping) for r in table if r.recording]),
        _within("natural frequencies", "table-2", [(r.number, r.frequency) for r in table if r.recording]),
        *((truth,) if truth is not None else ()),
        _standard(paper),
        _optimum(paper),
        _model(shown, "generic", "Generic damping gives every mode its measured damping back"),
        _model(shown, "rayleigh", "Rayleigh damping overestimates the modes above the second"),
    )


def _within(name: str, anchor: str, quantities: Sequence[tuple[int, table2.Quantity]]) -> Check:
    claim = f"Table 2’s {name} lie in our 99 % intervals"
    if not quantities:
        return Check(anchor, claim, "No mode of Table 2 was measured.", None)
    count = len(quantities)
    narrow = sum(q.level_holding(q.printed) <= 0.9 for _, q in quantities)
    off = [(n, q) for n, q in quantities if q.level_holding(q.printed) == 1.0]
    wide = of_all(count - len(off), count).capitalize()
    text = f"{wide} in the 99 % interval, {of_all(narrow, count)} in the 90 % interval"
    if off:
        verb = "differs" if len(off) == 1 else "differ"
        text += (
            f"; {modes_named([n for n, _ in off])} {verb} by {signed_range([q.difference for _, q in off])}"
        )
        apart = [q.truth / q.printed - 1.0 for _, q in off if q.level_holding(q.truth) < 1.0]
        if len(apart) == len(off):
            text += f". What was simulated differs from the paper as much, by {signed_range(apart)}"
    return Check(anchor, claim, text + ".", not off)


def _truth(table: Sequence[table2.Row]) -> Check | None:
    quantities = [
        q for row in table for q in (row.frequency, row.damping) if q.measured and q.truth == q.truth
    ]
    if not quantities:
        return None
    wide, narrow = (sum(q.level_holding(q.truth) <= level for q in quantities) for level in (0.99, 0.9))
    return Check(
        "table-2",
        "What was simulated for these recordings lies in our 99 % intervals",
        f"{of_all(wide, len(quantities)).capitalize()} values in the 99 % interval, "
        f"{of_all(narrow, len(quantities))} in the 90 % interval.",
        wide == len(quantities),
    )


def _standard(paper: Recomputed) -> Check:
    column, s = np.array(printed.TABLE_3_STANDARD_HZ), paper.standard
    error = largest(s.handbook_density_hz / column - 1.0)
    return Check(
        "table-3",
        f"Table 3’s standard column is reproduced within {percent(TOLERANCE, 1)} with "
        f"{HANDBOOK_DENSITY_KG_M3:.0f} kg/m³",
        f"Within {percent(error)}; with the printed {printed.TABLE_1_STANDARD.density_kg_m3:.0f} kg/m³ within "
        f"{percent(largest(s.printed_density_hz / column - 1.0))}.",
        error < TOLERANCE,
    )


def _optimum(paper: Recomputed) -> Check:
    reached = paper.optimum.reached
    error = largest(reached.updated_hz / np.array(printed.TABLE_3_OPTIMUM_HZ) - 1.0)
    inside = np.concatenate(
        [
            reached.width_factor,
            reached.thickness_factor,
            [reached.density_factor, reached.elastic_modulus_factor],
        ]
    )
    in_bound = bool(np.all(np.abs(inside - 1.0) <= reached.bound + 1e-9))
    return Check(
        "table-3",
        f"Table 3’s optimum column is reached within {percent(TOLERANCE, 1)} by the paper’s own variables",
        f"Within {within(error)}, {len(reached.at_bound)} of {inside.size} variables at ± {percent(reached.bound)}.",
        error < TOLERANCE and in_bound,
    )


def _model(shown: Sequence[decays.Row], model: str, claim: str) -> Check:
    own = [row for row in shown if row.model == model and np.isfinite(row.ratio_full)]
    if model == "rayleigh":
        own = [row for row in own if row.number > 2]
    if not own:
        return Check("figures", claim, "No such decay was simulated.", None)
    ratios = [row.ratio_full for row in own]
    numbers = modes_named([row.number for row in own])
    error = largest(np.array(ratios) - 1.0)
    finding = f"{listed(row.ratio for row in own)} times the measured damping in {numbers}."
    if model == "generic" and error < decays.NEAR:
        finding = f"Within {within(error)} in {numbers}."
    holds = error < decays.NEAR if model == "generic" else min(ratios) > 1.0 + decays.NEAR
    return Check("figures", claim, finding, holds)

"""The paper's claims, each with its verdict for these numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modalcam.paper import decays, table2
from modalcam.paper.recomputed import HANDBOOK_DENSITY_KG_M3, Recomputed
from modalcam.paper.text import largest, listed, modes_named, of_all, signed_range, within
from modalcam.report.style.format import fixed, percent
from sim.reference import paper_tables as printed

# Largest relative error of a reproduced column of Table 3.
TOLERANCE = 1e-3


@dataclass(frozen=True)
class Check:
    """One claim; `holds` is None if the folder has nothing to check it with."""

    anchor: str
    claim: str
    finding: str
    holds: bool | None

    @property
    def state(self) -> str:
        """Class of the line on the page."""
        return "none" if self.holds is None else "good" if self.holds else "care"

    @property
    def verdict(self) -> str:
        """In one or two words."""
        return "not checked" if self.holds is None else "holds" if self.holds else "does not hold"


def checks(table: Sequence[table2.Row], shown: Sequence[decays.Row], paper: Recomputed) -> tuple[Check, ...]:
    """All claims, in the paper's order."""
    return (
        _agrees("damping ratios", [(r.number, r.damping) for r in table]),
        _agrees("natural frequencies", [(r.number, r.frequency) for r in table]),
        *_truth(table2.simulated(table)),
        _standard(paper),
        _optimum(paper),
        _generic(shown),
        _rayleigh(shown),
    )


def _agrees(name: str, quantities: Sequence[tuple[int, table2.Quantity]]) -> Check:
    claim = f"Table 2’s {name} lie in our 99 % intervals"
    a = table2.agreement(quantities)
    if not a.count:
        return Check("table-2", claim, "No mode of Table 2 was measured.", None)
    narrow, wide = of_all(a.narrow, a.count), of_all(a.wide, a.count).capitalize()
    text = f"{wide} in the 99 % interval, {narrow} in the 90 % interval"
    if a.off:
        verb = "differs" if len(a.off) == 1 else "differ"
        differences = signed_range([q.difference for _, q in a.off])
        text += f"; {modes_named([n for n, _ in a.off])} {verb} by {differences}"
        if all(q.level_containing(q.truth) < 1.0 for _, q in a.off):
            text += f". The simulated values differ from the paper by {signed_range([q.apart for _, q in a.off])} too"
    return Check("table-2", claim, text + ".", not a.off)


def _truth(quantities: Sequence[table2.Quantity]) -> tuple[Check, ...]:
    if not quantities:
        return ()
    levels = [q.level_containing(q.truth) for q in quantities]
    wide, narrow = (sum(level <= limit for level in levels) for limit in (0.99, 0.9))
    finding = (
        f"{of_all(wide, len(levels)).capitalize()} values in the 99 % interval, {of_all(narrow, len(levels))} in the "
        "90 % interval."
    )
    claim = "The values with which these recordings were simulated lie in our 99 % intervals"
    return (Check("table-2", claim, finding, wide == len(levels)),)


def _standard(paper: Recomputed) -> Check:
    column, s = np.array(printed.TABLE_3_STANDARD_HZ), paper.standard
    error = s.handbook_density_hz / column - 1.0
    return Check(
        "table-3",
        f"Table 3’s standard column is reproduced within {percent(TOLERANCE, 1)} with "
        f"{HANDBOOK_DENSITY_KG_M3:.0f} kg/m³",
        f"Within {within(error)}; with the printed {printed.TABLE_1_STANDARD.density_kg_m3:.0f} kg/m³ within "
        f"{within(s.printed_density_hz / column - 1.0)}.",
        largest(error) < TOLERANCE,
    )


def _optimum(paper: Recomputed) -> Check:
    reached = paper.optimum.reached
    error = reached.updated_hz / np.array(printed.TABLE_3_OPTIMUM_HZ) - 1.0
    factors = np.concatenate(
        [
            reached.width_factor,
            reached.thickness_factor,
            [reached.density_factor, reached.elastic_modulus_factor],
        ]
    )
    in_bound = bool(np.all(np.abs(factors - 1.0) <= reached.bound + 1e-9))
    return Check(
        "table-3",
        f"Table 3’s optimum column is reached within {percent(TOLERANCE, 1)} by the paper’s own variables",
        f"Within {within(error)}, {len(reached.at_bound)} of {factors.size} variables at ± {percent(reached.bound)}.",
        largest(error) < TOLERANCE and in_bound,
    )


def _generic(shown: Sequence[decays.Row]) -> Check:
    claim = "Generic damping reproduces the measured damping of every mode"
    own = [row for row in shown if row.model.model == "generic" and row.identified]
    if not own:
        return Check("figures", claim, "No such decay was simulated.", None)
    if not all(row.near for row in own):
        return Check("figures", claim, _ratios(own), holds=False)
    error = within([row.ratio - 1.0 for row in own])
    return Check("figures", claim, f"Within {error} in {modes_named([r.number for r in own])}.", holds=True)


def _rayleigh(shown: Sequence[decays.Row]) -> Check:
    claim = "Rayleigh damping overestimates the modes above the second"
    own = [row for row in shown if row.model.model == "rayleigh" and row.identified and row.number > 2]
    if not own:
        return Check("figures", claim, "No such decay was simulated.", None)
    return Check("figures", claim, _ratios(own), all(row.ratio > 1.0 + decays.NEAR for row in own))


def _ratios(own: Sequence[decays.Row]) -> str:
    ratios = listed(fixed(row.ratio, 2) for row in own)
    return f"{ratios} times the measured damping in {modes_named([row.number for row in own])}."

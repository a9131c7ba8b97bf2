"""The page's tables for the terminal, and its numbers for programs."""

from __future__ import annotations

import math
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from modalcam.paper import table2
from modalcam.paper.page import PaperPage

_STYLES = {"good": "green", "care": "yellow", "none": "dim"}


def show(page: PaperPage, console: Console) -> None:
    """Print Tables 2 and 3 beside the paper's, and what holds."""
    console.print(_identified(page))
    console.print(_frequencies(page))
    for check in page.checks:
        line = Text(f"{check.verdict}: ", style=_STYLES[check.state])
        line.append(f"{check.claim}. {check.finding}", style="default")
        console.print(line)


def _identified(page: PaperPage) -> Table:
    names = [
        "mode",
        "f / Hz: paper",
        "ours",
        "simulated",
        "ζ / %: paper",
        "ours",
        "90 % interval",
        "simulated",
    ]
    table = Table(*names, title="Table 2")
    for row in page.table2:
        f, z = table2.cells(row.frequency), table2.cells(row.damping)
        cells = (str(row.number), f.printed, f.ours, f.truth, z.printed, z.ours, z.interval, z.truth)
        table.add_row(*(Text(cell) for cell in cells))
    return table


def _frequencies(page: PaperPage) -> Table:
    names = ["frequencies / Hz", "", *(f"mode {n}" for n in range(1, 6)), "largest error"]
    table = Table(*names, title="Table 3")
    for group in page.table3:
        for line in group.lines:
            cells = (line.label, line.source, *(text for text, _, _ in line.texts), line.largest_text)
            table.add_row(*(Text(cell) for cell in cells))
        table.add_section()
    return table


def numbers(page: PaperPage) -> dict[str, Any]:
    """The page's numbers as JSON-able values; what is unknown is None."""
    return {
        "folder": page.folder,
        "checks": [{"claim": c.claim, "finding": c.finding, "holds": c.holds} for c in page.checks],
        "table_2": [
            {
                "mode": row.number,
                "recording": row.recording,
                "frequency_hz": _quantity(row.frequency),
                "damping_ratio_percent": _quantity(row.damping),
            }
            for row in page.table2
        ],
        "table_3": [
            {
                "group": group.title,
                "line": line.label,
                "source": line.source,
                "frequency_hz": [_known(float(f)) for f in line.frequency_hz],
                "relative_error": [_known(float(e)) for e in line.error],
            }
            for group in page.table3
            for line in group.lines
        ],
        "decays": [
            {
                "panel": row.panel,
                "mode": row.number,
                "recording": row.recording,
                "model": row.model,
                "simulated_over_measured_damping": _known(row.ratio_full),
                "nrmse": _known(row.nrmse_full),
                "coverage_90": _known(row.coverage_full),
            }
            for row in page.models
        ],
    }


def _quantity(q: table2.Quantity) -> dict[str, Any]:
    return {
        "paper": q.printed,
        "simulated": _known(q.truth),
        "measured": _known(q.value),
        "sd": _known(q.sd),
        "interval_90": [_known(v) for v in q.interval_90],
        "interval_99": [_known(v) for v in q.interval_99],
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None

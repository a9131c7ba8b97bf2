"""A material in the terminal and as a table."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from modalcam.apps.material.material import Material
from modalcam.apps.material.plugin import MATERIAL_COLUMNS, material_rows
from modalcam.common import for_terminal
from modalcam.report.style import interval, with_sd
from modalcam.tables import write_table


def show(found: Material, console: Console) -> None:
    """Print the values, the conditions of the equations, and what the intervals lack."""
    console.print(f"Computed with the equations of {found.values[0].equations}.", style="bold")
    table = Table("mode", "Hz", "quantity", "value ± sd", "90 % interval", "largest source", box=SIMPLE_HEAD)
    for row in found.values:
        unit = "" if row.unit == "1" else f" {row.unit}"
        source = f"{row.largest_source} {100.0 * row.share:.0f} %" if row.largest_source else ""
        cells = (
            "" if row.mode is None else str(row.mode),
            with_sd(row.frequency_hz, row.frequency_sd_hz),
            row.quantity,
            with_sd(row.value, row.sd) + unit,
            interval(row.q05, row.q95, row.sd),
            source,
        )
        table.add_row(*map(for_terminal, cells))
    console.print(table)
    for condition in found.conditions:
        console.print(for_terminal(f"{condition.state}: {condition.text}"), markup=False, highlight=False)
    for text in found.notes:
        console.print(for_terminal(text), markup=False, highlight=False)


def write_csv(found: Material, path: Path) -> None:
    """Write ``material.csv``, one row a value."""
    columns = pd.Index([column.name for column in MATERIAL_COLUMNS])
    write_table(path, [pd.DataFrame(material_rows(found), columns=columns)])

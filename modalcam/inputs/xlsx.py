"""Columns of the first sheet of a workbook (.xlsx), as phyphox and spreadsheets write it."""

from __future__ import annotations

import warnings
from pathlib import Path

import pandas as pd

from modalcam.inputs.program_tables import of_motion


def read_xlsx(path: Path) -> tuple[pd.DataFrame, list[str]]:
    """Columns of the first sheet, whose first row names them; ValueError if it cannot be read."""
    try:
        with warnings.catch_warnings():
            # openpyxl warns of styles.
            warnings.simplefilter("ignore", UserWarning)
            table = pd.read_excel(path, engine="openpyxl")
    except ImportError:
        msg = "a workbook, which needs openpyxl; install it with pip install openpyxl"
        raise ValueError(msg) from None
    except Exception as error:
        msg = f"no readable workbook ({error})"
        raise ValueError(msg) from error
    if table.empty:
        msg = "a workbook whose first sheet is empty"
        raise ValueError(msg)
    table, notes = of_motion(table.set_axis([str(name) for name in table.columns], axis=1))
    return table, ["The table is the first sheet of the workbook.", *notes]

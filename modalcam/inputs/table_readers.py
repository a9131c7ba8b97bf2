"""Registry of formats of tables, each by the ending of its files; a file with any other ending is read as text.

The reader of workbooks (.xlsx), as phyphox and spreadsheets write them, stands here.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from modalcam.inputs.array_files import read_hdf5, read_mat, read_npy
from modalcam.inputs.program_tables import of_motion
from modalcam.inputs.tdms import read_tdms
from modalcam.inputs.text_table import read_lvm


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


UFF_ENDINGS = (".uff", ".unv", ".u58", ".uf")
# From the path: columns by name, and sentences on what was taken for what; ValueError for other content. The attribute
# ``unit`` of the columns, if there is one, is that of all channels.
TableReader = Callable[[Path], tuple[pd.DataFrame, list[str]]]
TABLE_READERS: dict[str, TableReader] = {
    ".npy": read_npy,
    ".mat": read_mat,
    ".lvm": read_lvm,
    ".tdms": read_tdms,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".nc": read_hdf5,
    ".xlsx": read_xlsx,
}


def register_table_reader(suffix: str, read: TableReader) -> None:
    """Read files of `identify` with this ending, in lower case, by `read`; ValueError if the ending is taken."""
    if suffix in UFF_ENDINGS or TABLE_READERS.setdefault(suffix, read) is not read:
        msg = f"files ending in {suffix!r} have a reader already; choose another ending"
        raise ValueError(msg)

"""Registry of formats of tables, each by the ending of its files; a file with any other ending is read as text.

The readers of workbooks (.xlsx), as phyphox and spreadsheets write them, and of TDMS files of LabVIEW stand here.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from modalcam.inputs.array_files import read_hdf5, read_mat, read_npy
from modalcam.inputs.program_tables import of_motion
from modalcam.inputs.stated import REAL_KINDS, insert_times, note_unit
from modalcam.inputs.text_table import read_lvm

# Kind of NumPy for time stamps.
_STAMPS = "M"


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


def read_tdms(path: Path) -> tuple[pd.DataFrame, list[str]]:
    """Numeric channels of a TDMS file that are as long as the longest, as ``group channel`` where names repeat.

    The times are those of a channel called time; otherwise those that the properties ``wf_increment`` and
    ``wf_start_offset`` of waveforms give, or the only channel of time stamps. ValueError if the file cannot be read,
    has no numeric channel or channels of one name, or has waveforms of different rates or starts.
    """
    found, doubts = _channels(path)
    length = max((values.size for _, values in found), default=0)
    used = [(c, v) for c, v in found if v.size == length and v.dtype.kind in REAL_KINDS]
    names = [c.name for c, _ in used]
    columns = pd.DataFrame(
        {c.name if names.count(c.name) == 1 else f"{c.group_name} {c.name}": v for c, v in used}
    )
    if columns.empty or columns.shape[1] < len(names):
        msg = (
            f"a TDMS file with the numeric channels {', '.join(names) or 'none'}; give each a name of its own"
        )
        raise ValueError(msg)
    notes = [
        f"{len(used)} of {len(found)} channels of the TDMS file are used: those of {length} numbers.",
        *doubts,
    ]
    clocks = {
        (1.0 / float(c.properties["wf_increment"]), float(c.properties.get("wf_start_offset", 0.0)))
        for c, _ in used
        if float(c.properties.get("wf_increment", 0.0)) > 0.0
    }
    if len({start_s for _, start_s in clocks}) > 1:
        msg = "waveforms that begin at different times; export those of one start"
        raise ValueError(msg)
    insert_times(columns, notes, {rate for rate, _ in clocks}, next((start_s for _, start_s in clocks), 0.0))
    note_unit(columns, notes, {str(c.properties.get("unit_string", "")) for c, _ in used})
    stamps = [v for _, v in found if v.size == length and v.dtype.kind == _STAMPS]
    if not clocks and len(stamps) == 1:
        columns.insert(0, "time (s)", (stamps[0] - stamps[0][0]) / np.timedelta64(1, "s"))
    return columns, notes


def _channels(path: Path) -> tuple[list[tuple[Any, np.ndarray]], list[str]]:
    """Channels of numbers and time stamps with their values, and what nptdms says on a damaged file."""
    try:
        from nptdms import TdmsFile  # noqa: PLC0415 - optional
        from nptdms.log import log_manager  # noqa: PLC0415
    except ImportError:
        msg = "a TDMS file, which needs nptdms; install it with pip install nptdms"
        raise ValueError(msg) from None
    said = io.StringIO()
    # not by setStream, which flushes the other stream: that of the first import may be closed
    handler = log_manager.console_handler
    printed, handler.stream = handler.stream, said
    try:
        with path.open("rb") as stream, TdmsFile.open(stream) as file:
            found = [c for g in file.groups() for c in g.channels() if c.dtype.kind in REAL_KINDS + _STAMPS]
            # A value takes at least one byte: what is only claimed takes no memory.
            claimed = sum(len(c) for c in found) > path.stat().st_size
            channels = [] if claimed else [(c, np.asarray(c[:])) for c in found if len(c)]
    except Exception as error:
        msg = f"no readable TDMS file ({error})"
        raise ValueError(msg) from error
    finally:
        handler.stream = printed
    lines = sorted(set(said.getvalue().splitlines()))
    return channels, [f"Reader of TDMS files: {line.partition('] ')[2].rstrip('.')}." for line in lines]


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

"""Registry of the output formats: every file of OUT but the report.

A new format is a `Writer` in a separate file and one entry here, or a call of `register_writer` in a plugin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from modalcam.config import ExperimentConfig
from modalcam.pipeline import RunResult, Workspace
from modalcam.tables import csv_files as tables
from modalcam.tables import first_frame, netcdf, uff, workbook
from modalcam.tables.base import REGISTERED, Output, Writer
from modalcam.tables.summary import CONFIG, SUMMARY

# In the order in which they are written.
WRITERS: dict[str, Writer] = {
    writer.name: writer
    for writer in (
        tables.TRACKS,
        first_frame.FIRST_FRAME,
        netcdf.POSTERIOR,
        uff.UNIVERSAL,
        tables.MODES,
        workbook.WORKBOOK,
        tables.ALIASES,
        tables.SHAPES,
        tables.RESPONSE,
        tables.PARTICIPATION,
        tables.COMPARISON,
        tables.UPDATING,
        *tables.LAWS,
        SUMMARY,
        CONFIG,
    )
}


def register_writer(writer: Writer) -> None:
    """Add an output format, whose name must be new; its files are written after those of the others."""
    if WRITERS.setdefault(writer.name, writer) is not writer:
        msg = f"a writer named {writer.name!r} is registered already; choose another name"
        raise ValueError(msg)


def outputs(workspace: Workspace, result: RunResult, config: ExperimentConfig) -> Iterator[Output]:
    """Files of all formats whose libraries are installed, then registered tables that have rows."""
    added = (
        tables.table_writer(name.removesuffix(".csv"), one.about, one.rows, one.columns)
        for name, one in REGISTERED.items()
        if one.rows is not None and one.rows(result)
    )
    for writer in (*WRITERS.values(), *added):
        if not writer.missing:
            for output in writer.outputs(workspace, result, config):
                yield replace(output, about=writer.description)


def with_missing_formats(result: RunResult) -> RunResult:
    """The result with a sentence for each format that cannot be written, for the report's list of skipped steps."""
    missing = tuple(writer.missing for writer in WRITERS.values() if writer.missing)
    return replace(result, not_done=(*result.not_done, *missing))

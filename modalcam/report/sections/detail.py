"""How much is drawn of each recording, so that a page of many stays within its size."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Detail:
    """What each recording's section holds.

    Attributes
    ----------
    strips : int
        Channels drawn in the displacement figure.
    diagnostics : bool
        Close-up, envelope and spectrum.
    figures : bool
        Any figure at all.
    note : str
        What was left out, for the reader; empty when nothing was.
    """

    strips: int
    diagnostics: bool
    figures: bool
    note: str = ""


def detail_for(recordings: int) -> Detail:
    """Full detail up to 12 recordings, less for more: a browser must still open the page."""
    if recordings <= 12:
        return Detail(strips=8, diagnostics=True, figures=True)
    if recordings <= 40:
        return Detail(
            strips=2,
            diagnostics=False,
            figures=True,
            note=f"With {recordings} recordings in one page, close-ups, envelopes and spectra are not "
            "drawn, and two channels "
            "a recording are. Run fewer recordings at a time to see all figures.",
        )
    return Detail(
        strips=1,
        diagnostics=False,
        figures=False,
        note=f"With {recordings} recordings in one page, their figures are not drawn. Run fewer "
        "recordings at a time to see "
        "them.",
    )

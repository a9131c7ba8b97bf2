"""Colours and type of the figures.

Each colour is drawn as a fixed hexadecimal value and replaced by a variable of the style sheet in the SVG, so that
figures follow the page into dark mode and print. The hues are those of Okabe and Ito, distinguishable by colour-blind
readers; wherever two lines share a figure they differ in dash or marker too.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from sim.damping import DAMPING_MODELS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#1c2126"
MUTED = "#5c6670"
FAINT = "#c9cfd5"
PAPER = "#fdfdfc"
MEASURED = "#6f7b87"
FIT = "#00825f"
ALERT = "#a8326e"
# The first two damping models; also for other pairs of lines.
GENERIC = DAMPING_MODELS["generic"].colour
RAYLEIGH = DAMPING_MODELS["rayleigh"].colour

_VARIABLES = {
    INK: "--ink",
    MUTED: "--muted",
    FAINT: "--faint",
    PAPER: "--card",
    MEASURED: "--measured",
    FIT: "--fit",
    ALERT: "--alert",
}


def variables() -> dict[str, str]:
    """Variable of the style sheet for each colour of a figure, those of the damping models included."""
    return _VARIABLES | {entry.colour: f"--damping-{key}" for key, entry in DAMPING_MODELS.items()}


WIDTH_IN = 8.6
# Pixel columns that a trace across the whole figure is thinned to.
COLUMNS = 640

_RC = {
    # Ids are made unique within the page by their figure's prefix.
    "svg.hashsalt": "modalcam",
    "svg.fonttype": "none",
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.edgecolor": MUTED,
    "axes.facecolor": "none",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.use_mathtext": False,
    "axes.formatter.useoffset": False,
    "axes.unicode_minus": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.loc": "upper right",
    "legend.borderaxespad": 0.0,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "lines.solid_capstyle": "round",
    "lines.solid_joinstyle": "round",
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Settings under which figures are drawn, independent of the user's matplotlib settings."""
    import matplotlib.style  # noqa: PLC0415 - only to draw

    with matplotlib.style.context(["default", _RC]):
        yield


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """An empty figure; call within `figure_style`."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - only to draw

    from modalcam.report.style.figure import GridLayout  # noqa: PLC0415

    return Figure(figsize=(width_in, height_in), layout=GridLayout())

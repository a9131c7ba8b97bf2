"""A matplotlib figure as inline SVG: with a title for screen readers, the colours of the page and unique ids."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from markupsafe import Markup, escape

from modalcam.report.style.figure import variables
from modalcam.report.style.text import trusted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The page has a style sheet; matplotlib writes no other elements of these names.
_DROPPED = re.compile(r"<(metadata|style)\b.*?</\1>|(?<=>)\s+(?=<)", re.DOTALL)
# Text between tags has its angle brackets escaped: a tag never begins within it.
_TAG = re.compile("<[^<>]*>")
_USED = re.compile(r'(?:url\(|href=")#([^)"]+)')
# Groups that the script of the page looks for.
_GROUPS = {"axes": "axes", "matplotlib.axis": "axis", "legend": "legend"}
_ID_ATTRIBUTE = re.compile(r' id="([^"]*)"')
# Rotations by nothing, which every level text has, are a fiftieth of a page.
_UNROTATED = re.compile(r' transform="rotate\(-?0(?:\.0*)? [^"]*"')
_COORDINATES = re.compile(r' (?:d|points|[xy][12]?|width|height|transform|viewBox)="[^"]*"')
_NUMBER = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")
_COLOUR = re.compile("#[0-9a-f]{6}")
_FONT = re.compile(r"font(?:-family)?:\s*(?:(\S+)\s+)?'DejaVu Sans'[^;\"]*")
# Paths longer than this many characters are dense traces, for which a tenth of a point is enough.
_LONG = 2000
# Stands for the id of the figure in its page; no XML text can contain it.
_ID = "\x1a"


@dataclass(frozen=True)
class FigureView:
    """A figure as the page shows it; `reading` says how to read any figure of the kind `key`."""

    id: str
    key: str
    title: str
    svg: Markup
    caption: str
    reading: str = ""


def figure_svg(figure: Figure) -> str:
    """SVG of `figure` for `inline`, the same for every page; call within `palette.figure_style`."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG  # noqa: PLC0415 - only to draw

    buffer = io.StringIO()
    # Figure.savefig would draw everything once more before, only to measure it.
    FigureCanvasSVG(figure).print_svg(  # type: ignore[no-untyped-call]  # matplotlib types no canvas
        buffer, metadata={"Date": None, "Creator": None, "Type": None, "Format": None}
    )
    text = buffer.getvalue()
    used, names = set(_USED.findall(text)), variables()
    text = _TAG.sub(lambda tag: _rewritten(tag[0], used, names), _DROPPED.sub("", text[text.index("<svg") :]))
    return text.replace("<svg", f'<svg data-axes="{_ranges(figure)}"', 1)


def _ranges(figure: Figure) -> str:
    """Of each axes: left, top, width and height in points, limits of x and y, and whether x and y are logarithmic."""
    width, height = (72.0 * length for length in figure.get_size_inches())
    rows = []
    for axes in figure.axes:
        box = axes.get_position()
        place = (box.x0 * width, (1.0 - box.y1) * height, box.width * width, box.height * height)
        scales = (axes.get_xscale(), axes.get_yscale())
        texts = [f"{value:.2f}" for value in place] + [
            f"{v:.9g}" for v in (*axes.get_xlim(), *axes.get_ylim())
        ]
        rows.append(",".join([*texts, *("1" if scale == "log" else "0" for scale in scales)]))
    return f"[[{'],['.join(rows)}]]" if rows else "[]"


def inline(svg: str, figure_id: str, alt: str) -> Markup:
    """SVG by `figure_svg` with its name in the page: a prefix of its ids, and a title for screen readers.

    `figure_id` is unique in the page: letters, digits and hyphens.
    """
    root, _, body = svg.replace(_ID, figure_id).partition(">")
    return trusted(f'{root}><title id="{figure_id}-title">{escape(alt)}</title>{body}')


def _rewritten(tag: str, used: set[str], names: Mapping[str, str]) -> str:
    tag = _COORDINATES.sub(_rounded, _UNROTATED.sub("", tag))
    if tag.startswith("<svg"):
        # Any other attribute of the root would set a size that does not follow the page.
        box = re.search(' viewBox="[^"]*"', tag)
        name = f'role="img" aria-labelledby="{_ID}-title"'
        return f'<svg{box[0] if box else ""} {name} preserveAspectRatio="xMidYMid meet">'
    tag = _ID_ATTRIBUTE.sub(lambda own: _name(own[1], used), tag)
    tag = tag.replace('xlink:href="#', f'href="#{_ID}-').replace("url(#", f"url(#{_ID}-")
    tag = _COLOUR.sub(lambda own: f"var({names[own[0]]})" if own[0] in names else own[0], tag)
    return _FONT.sub(lambda font: f"font-size: {font[1]}" if font[1] else "font-family: inherit", tag)


def _name(own: str, used: set[str]) -> str:
    """Attribute that replaces an id: a class of the groups that a script needs, an id of what others refer to."""
    if own in used:
        return f' id="{_ID}-{own}"'
    group = _GROUPS.get(own.rpartition("_")[0])
    return "" if group is None else f' class="{group}"'


def _rounded(attribute: re.Match[str]) -> str:
    places = 1 if len(attribute[0]) > _LONG else 2

    def rounded(number: re.Match[str]) -> str:
        text = f"{float(number[0]):.{places}f}".rstrip("0").rstrip(".")
        return "0" if text in ("", "-0") else text

    # matplotlib ends every segment of a path with a line.
    return re.sub(r"\s+", " ", _NUMBER.sub(rounded, attribute[0])).replace(' "', '"')

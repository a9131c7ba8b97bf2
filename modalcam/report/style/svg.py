"""A matplotlib figure as inline SVG: with a title for screen readers, the colours of the page and unique ids."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from xml.etree import ElementTree as ET

from markupsafe import Markup, escape
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from modalcam.report.style.palette import variables
from modalcam.report.style.text import trusted

_SVG = "http://www.w3.org/2000/svg"
_XLINK = "http://www.w3.org/1999/xlink"
_USED = re.compile(r'(?:url\(|href=")#([^)"]+)')
_UNROTATED = re.compile(r"rotate\(-?0(\.0*)? ")
_SPACE = re.compile(r"\s+")
_NUMBER = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")
_COLOUR = re.compile("#[0-9a-f]{6}")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_FONT = re.compile(r"font(?:-family)?:\s*(?:(\S+)\s+)?'DejaVu Sans'[^;]*")
_COORDINATES = ("d", "points", "x", "y", "width", "height", "x1", "y1", "x2", "y2", "transform", "viewBox")
# Paths longer than this many characters are dense traces, for which a tenth of a point is enough.
_LONG = 2000
# Stands for the id of the figure in its page; no XML text can contain it.
_ID = "\x1a"


@dataclass(frozen=True)
class FigureView:
    """A figure as the page shows it."""

    id: str
    title: str
    svg: Markup
    caption: str


def figure_svg(figure: Figure) -> str:
    """SVG of `figure` for `inline`, the same for every page; call within `palette.figure_style`."""
    buffer = io.StringIO()
    # Figure.savefig would draw everything once more before, only to measure it.
    FigureCanvasSVG(figure).print_svg(  # type: ignore[no-untyped-call]
        buffer, metadata={"Date": None, "Creator": None, "Type": None, "Format": None}
    )
    text = buffer.getvalue()
    # matplotlib's own output: it holds no entities from outside.
    root = ET.fromstring(text)  # noqa: S314
    used = set(_USED.findall(text))
    names = variables()
    _prune(root)
    for element in root.iter():
        element.tag = element.tag.removeprefix(f"{{{_SVG}}}")
        if element.get("id") not in used:
            element.attrib.pop("id", None)
        _rewrite(element, names)
    # Any other attribute of the root would set a size that does not follow the page.
    root.attrib = {
        "viewBox": root.get("viewBox", ""),
        "role": "img",
        "aria-labelledby": f"{_ID}-title",
        "preserveAspectRatio": "xMidYMid meet",
    }
    return ET.tostring(root, encoding="unicode")


def inline(svg: str, figure_id: str, alt: str) -> Markup:
    """SVG by `figure_svg` with its name in the page: a prefix of its ids, and a title for screen readers.

    `figure_id` is unique in the page: letters, digits and hyphens.
    """
    root, _, body = svg.replace(_ID, figure_id).partition(">")
    return trusted(f'{root}><title id="{figure_id}-title">{escape(alt)}</title>{body}')


def _prune(parent: ET.Element) -> None:
    """Remove metadata, the style sheet (the page has one) and white space between elements."""
    for child in list(parent):
        if child.tag in (f"{{{_SVG}}}metadata", f"{{{_SVG}}}style"):
            parent.remove(child)
            continue
        child.tail = None
        _prune(child)
    if parent.tag not in (f"{{{_SVG}}}text", f"{{{_SVG}}}tspan"):
        parent.text = None


def _rewrite(element: ET.Element, names: Mapping[str, str]) -> None:
    link = element.attrib.pop(f"{{{_XLINK}}}href", None)
    if link is not None:
        element.set("href", f"#{_ID}-{link[1:]}" if link.startswith("#") else link)
    # Rotations by nothing, which every level text has, are a fiftieth of a page.
    if _UNROTATED.match(element.get("transform", "")):
        del element.attrib["transform"]
    for key, value in list(element.attrib.items()):
        new = value
        if key == "id":
            new = f"{_ID}-{value}"
        elif key in _COORDINATES:
            places = 1 if len(value) > _LONG else 2
            new = _NUMBER.sub(partial(_rounded, places=places), value)
            new = _SPACE.sub(" ", new).strip()
        elif key in ("style", "clip-path", "fill", "stroke"):
            new = _COLOUR.sub(partial(_variable, names=names), value)
            new = _REFERENCE.sub(rf"url(#{_ID}-\1)", new)
            new = _FONT.sub(_page_font, new)
        element.set(key, new)


def _page_font(font: re.Match[str]) -> str:
    return f"font-size: {font[1]}" if font[1] else "font-family: inherit"


def _variable(colour: re.Match[str], names: Mapping[str, str]) -> str:
    return f"var({names[colour[0]]})" if colour[0] in names else colour[0]


def _rounded(number: re.Match[str], places: int) -> str:
    text = f"{float(number[0]):.{places}f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text

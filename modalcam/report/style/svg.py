"""A matplotlib figure as inline SVG: named for screen readers, coloured by the page, its ids unique in the page."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from xml.etree import ElementTree as ET

from markupsafe import Markup
from matplotlib.figure import Figure

from modalcam.report.style.palette import variables
from modalcam.report.style.text import trusted, visible

_SVG = "http://www.w3.org/2000/svg"
_XLINK = "http://www.w3.org/1999/xlink"
_USED = re.compile(r'(?:url\(|href=")#([^)"]+)')
_UNTURNED = re.compile(r"rotate\(-?0(\.0*)? ")
_SPACE = re.compile(r"\s+")
_NUMBER = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")
_COLOUR = re.compile("#[0-9a-f]{6}")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_FONT = re.compile(r"font(?:-family)?:\s*(?:(\S+)\s+)?'DejaVu Sans'[^;]*")
_COORDINATES = ("d", "points", "x", "y", "width", "height", "x1", "y1", "x2", "y2", "transform", "viewBox")


# Characters beyond which a path is a dense trace: a tenth of a point is enough for it.
_LONG = 2000


@dataclass(frozen=True)
class FigureView:
    """A figure as the page shows it."""

    id: str
    title: str
    svg: Markup
    caption: str


def figure_view(figure: Figure, *, figure_id: str, title: str, alt: str, caption: str) -> FigureView:
    """Render `figure`; call within `palette.figure_style`.

    Parameters
    ----------
    figure_id : str
        Unique in the page; letters, digits and hyphens.
    title : str
        Heading above the figure.
    alt : str
        What the figure shows, for those who do not see it.
    caption : str
        What to look for.
    """
    buffer = io.StringIO()
    figure.savefig(
        buffer, format="svg", metadata={"Date": None, "Creator": None, "Type": None, "Format": None}
    )
    return FigureView(figure_id, title, trusted(_inline(buffer.getvalue(), figure_id, alt)), caption)


def _inline(text: str, figure_id: str, alt: str) -> str:
    # Our own file, just written: no entities from outside can be in it.
    root = ET.fromstring(text)  # noqa: S314
    used = set(_USED.findall(text))
    names = variables()
    _prune(root)
    for element in root.iter():
        element.tag = element.tag.removeprefix(f"{{{_SVG}}}")
        if element.get("id") not in used:
            element.attrib.pop("id", None)
        _rewrite(element, figure_id, names)
    _name(root, figure_id, alt)
    return ET.tostring(root, encoding="unicode")


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


def _rewrite(element: ET.Element, figure_id: str, names: Mapping[str, str]) -> None:
    link = element.attrib.pop(f"{{{_XLINK}}}href", None)
    if link is not None:
        element.set("href", f"#{figure_id}-{link[1:]}" if link.startswith("#") else link)
    # every level text is turned by nothing: a fiftieth of a page
    if _UNTURNED.match(element.get("transform", "")):
        del element.attrib["transform"]
    for key, value in list(element.attrib.items()):
        new = value
        if key == "id":
            new = f"{figure_id}-{value}"
        elif key in _COORDINATES:
            places = 1 if len(value) > _LONG else 2
            new = _NUMBER.sub(partial(_rounded, places=places), value)
            new = _SPACE.sub(" ", new).strip()
        elif key in ("style", "clip-path", "fill", "stroke"):
            new = _COLOUR.sub(partial(_variable, names=names), value)
            new = _REFERENCE.sub(lambda match: f"url(#{figure_id}-{match[1]})", new)
            new = _FONT.sub(
                lambda match: f"font-size: {match[1]}" if match[1] else "font-family: inherit", new
            )
        element.set(key, new)


def _variable(colour: re.Match[str], names: Mapping[str, str]) -> str:
    return f"var({names[colour[0]]})" if colour[0] in names else colour[0]


def _rounded(number: re.Match[str], places: int) -> str:
    text = f"{float(number[0]):.{places}f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


def _name(root: ET.Element, figure_id: str, alt: str) -> None:
    # An attribute of the root besides these would set a size that does not follow the page.
    root.attrib = {
        "viewBox": root.get("viewBox", ""),
        "role": "img",
        "aria-labelledby": f"{figure_id}-title",
        "preserveAspectRatio": "xMidYMid meet",
    }
    title = ET.Element("title", {"id": f"{figure_id}-title"})
    title.text = visible(alt)
    root.insert(0, title)

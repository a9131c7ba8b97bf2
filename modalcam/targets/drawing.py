"""A drawing in millimetres, written as SVG or PDF at true scale with the same bytes every time."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

MM_PER_POINT = 25.4 / 72.0
# Control points of four cubic curves that follow a circle to 3e-4 of its radius.
_KAPPA = 0.5522847498


@dataclass(frozen=True)
class Box:
    """Filled rectangle; x right, y down, from the page's top left corner."""

    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float


@dataclass(frozen=True)
class Shape:
    """Black boxes that are one print: drawn as one path, so that no seams show between neighbours."""

    boxes: tuple[Box, ...]


@dataclass(frozen=True)
class Disc:
    """Filled black disc."""

    x_mm: float
    y_mm: float
    diameter_mm: float


@dataclass(frozen=True)
class Frame:
    """Thin gray outline to cut along."""

    box: Box


@dataclass(frozen=True)
class Label:
    """A line of Latin-1 text that starts at x, its base line at y."""

    x_mm: float
    y_mm: float
    size_mm: float
    text: str


Item = Shape | Disc | Frame | Label


@dataclass(frozen=True)
class Page:
    """One sheet of paper."""

    width_mm: float
    height_mm: float
    items: tuple[Item, ...]


def svg_text(page: Page) -> str:
    """The page as SVG, a unit a millimetre."""
    width, height = _number(page.width_mm), _number(page.height_mm)
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}">'
    )
    lines = [
        head,
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
        *(_svg_item(item) for item in page.items),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _svg_item(item: Item) -> str:
    if isinstance(item, Shape):
        path = "".join(
            f"M{_number(b.x_mm)} {_number(b.y_mm)}h{_number(b.width_mm)}v{_number(b.height_mm)}"
            f"h{_number(-b.width_mm)}z"
            for b in item.boxes
        )
        return f'<path d="{path}"/>'
    if isinstance(item, Disc):
        return f'<circle cx="{_number(item.x_mm)}" cy="{_number(item.y_mm)}" r="{_number(item.diameter_mm / 2)}"/>'
    if isinstance(item, Frame):
        b = item.box
        return (
            f'<rect x="{_number(b.x_mm)}" y="{_number(b.y_mm)}" width="{_number(b.width_mm)}" '
            f'height="{_number(b.height_mm)}" fill="none" stroke="#bbb" stroke-width="0.1"/>'
        )
    return (
        f'<text x="{_number(item.x_mm)}" y="{_number(item.y_mm)}" font-size="{_number(item.size_mm)}" '
        f'font-family="Helvetica, Arial, sans-serif">{escape(item.text)}</text>'
    )


def pdf_bytes(pages: tuple[Page, ...]) -> bytes:
    """The pages as a PDF 1.4 file with uncompressed contents and no time stamps."""
    kids = " ".join(f"{4 + 2 * k} 0 R" for k in range(len(pages)))
    objects = [
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {len(pages)} >>",
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
    ]
    for k, page in enumerate(pages):
        box = f"[0 0 {_number(page.width_mm / MM_PER_POINT)} {_number(page.height_mm / MM_PER_POINT)}]"
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents {5 + 2 * k} 0 R "
            "/Resources << /Font << /F 3 0 R >> >> >>"
        )
        content = _pdf_content(page)
        objects.append(f"<< /Length {len(content.encode('latin-1'))} >>\nstream\n{content}\nendstream")
    out = bytearray(b"%PDF-1.4\n")
    offsets = []
    for number, text in enumerate(objects, start=1):
        offsets.append(len(out))
        out += f"{number} 0 obj\n{text}\nendobj\n".encode("latin-1")
    start = len(out)
    table = "".join(f"{offset:010d} 00000 n \n" for offset in offsets)
    size = len(objects) + 1
    out += (
        f"xref\n0 {size}\n0000000000 65535 f \n{table}trailer\n<< /Size {size} /Root 1 0 R >>\n"
        f"startxref\n{start}\n%%EOF\n"
    ).encode("latin-1")
    return bytes(out)


def _pdf_content(page: Page) -> str:
    """Millimetres with y up: the page's height turns ours over."""
    scale = f"{1 / MM_PER_POINT:.9f}"
    return "\n".join(
        [f"{scale} 0 0 {scale} 0 0 cm", *(_pdf_item(item, page.height_mm) for item in page.items)]
    )


def _pdf_item(item: Item, top_mm: float) -> str:
    if isinstance(item, Shape):
        return " ".join(_pdf_box(b, top_mm) for b in item.boxes) + " f"
    if isinstance(item, Frame):
        return f"0.73 G 0.1 w {_pdf_box(item.box, top_mm)} S"
    if isinstance(item, Disc):
        return _pdf_disc(item, top_mm)
    text = item.text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    x, y = _number(item.x_mm), _number(top_mm - item.y_mm)
    return f"BT /F {_number(item.size_mm)} Tf {x} {y} Td ({text}) Tj ET"


def _pdf_box(box: Box, top_mm: float) -> str:
    values = (box.x_mm, top_mm - box.y_mm - box.height_mm, box.width_mm, box.height_mm)
    return " ".join(map(_number, values)) + " re"


def _pdf_disc(disc: Disc, top_mm: float) -> str:
    x, y, r = disc.x_mm, top_mm - disc.y_mm, 0.5 * disc.diameter_mm
    k = _KAPPA * r
    curves = (
        (x + r, y + k, x + k, y + r, x, y + r),
        (x - k, y + r, x - r, y + k, x - r, y),
        (x - r, y - k, x - k, y - r, x, y - r),
        (x + k, y - r, x + r, y - k, x + r, y),
    )
    path = " ".join(" ".join(map(_number, curve)) + " c" for curve in curves)
    return f"{_number(x + r)} {_number(y)} m {path} f"


def _number(value: float) -> str:
    text = f"{value:.4f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text

"""Text from files and users made safe to show: no hidden or reordering characters, no paths of this machine."""

from __future__ import annotations

import re
import shlex

from markupsafe import Markup

from modalcam.names import shown

# Scripts that the figures' font draws, left to right: Latin, Greek, Cyrillic with their accents.
_LAST_IN_FONT = 0x52F
_THOUSANDS = re.compile(r"(?<=\d)\\u202f(?=\d{3}(?!\d))")
# What must not change, or the space before a unit, and on the right of a comparison or sign.
_NUMBER_GAP = re.compile(
    r"<(?P<kept>style|script|title|svg|pre|code|data)\b.*?</(?P=kept)>|<[^<>]*>"
    r"|(?<=\d) (?=(?:%|[µmk]?Hz|[µm]?s|[µmk]?m|px|fps|ppm|m?rad|nats?|[GM]Pa|kg|bit|×)(?![\w]))"
    r"|(?<=[=≤≥±×]) (?=[−\d])|(?<=&[lg]t;) (?=[−\d])|(?<=\w) (?=(?:[=≤≥±]|&[lg]t;) [−\d])",
    re.DOTALL,
)
_POSIX_PATH = re.compile(r"(?<![\w/.:~<])~?/(?:[^/\s'\"<>,;]+/)+(?=[^/\s])")
_WINDOWS_PATH = re.compile(r"(?<![\w])[A-Za-z]:[\\/](?:[^\\/\s'\"<>,;]+[\\/])*(?=[^\\/\s])")


def trusted(markup: str) -> Markup:
    """Declare text to be markup: only the package's own style sheet and script, and SVG written by an XML writer.

    File names, configurations and recordings never pass through here as text; the SVG writer has escaped them.
    """
    return Markup(markup)  # noqa: S704 - the audited wrapper


def unbroken(page: str) -> str:
    """HTML whose numbers stay in one line with their units, signs and comparisons, by no-break spaces.

    Values in tables, preformatted text, figures and attributes are unchanged.
    """
    return _NUMBER_GAP.sub(lambda found: found[0] if found[0] != " " else "\u00a0", page)


def visible(text: str) -> str:
    """Text with controls, direction marks, odd spaces and undecodable bytes written as escapes.

    The narrow space that sets thousands apart stays, where it stands between digits.
    """
    if text.isprintable():
        return text
    shown_text = "".join(c if c == " " or c.isprintable() else _escaped(c) for c in shown(text))
    return _THOUSANDS.sub("\u202f", shown_text)


def prose(text: str) -> str:
    """A sentence of the program, with the folders of absolute local paths left out."""
    return _WINDOWS_PATH.sub("…/", _POSIX_PATH.sub("…/", visible(text)))


def command(text: str) -> str:
    """A command line, with the folders of absolute local paths left out, quoted as a shell needs it."""
    try:
        words = shlex.split(text)
    except ValueError:
        return prose(text)
    return " ".join(_word(word) for word in words)


def figure_label(text: str, *, limit: int = 22) -> str:
    """A name for a figure: characters outside the figures' font as escapes, cut to `limit` characters."""
    plain = "".join(c if ord(c) <= _LAST_IN_FONT else _escaped(c) for c in visible(text))
    return plain if len(plain) <= limit else plain[: limit - 1] + "…"


def quantity(unit: str) -> str:
    """What a series in this unit is: "acceleration", "velocity" or "displacement"."""
    plain = unit.strip().lower().replace("²", "2").replace("^", "").replace("**", "").replace(" ", "")
    if plain in ("g", "gal") or re.fullmatch(r"[a-zµ]*m(/s/s|/s2|s-2)", plain):
        return "acceleration"
    return "velocity" if re.fullmatch(r"[a-zµ]*m(/s|s-1)", plain) else "displacement"


def channel_label(name: str) -> str:
    """A channel's name for a figure; a bare number is a marker's."""
    label = figure_label(name)
    return f"marker {label}" if label.isdecimal() else label


def sentence(text: str) -> str:
    """Text with a capital at its start and a full stop at its end."""
    text = text.strip()
    if not text:
        return ""
    # A file name or an option at the start stays unchanged.
    start = (
        text[0].upper()
        if re.match(r"[a-z]+[ ,.]", text + ".") and not re.match(r"\w+\.\w", text)
        else text[0]
    )
    return start + text[1:] + ("" if text[-1] in ".!?" else ".")


def _word(word: str) -> str:
    option, equals, value = word.partition("=")
    if not equals or not option.startswith("-"):
        option, equals, value = "", "", word
    if re.match(r"~?/|[A-Za-z]:[\\/]", value):
        value = "…/" + re.split(r"[\\/]", value.rstrip("\\/"))[-1]
    word = visible(f"{option}{equals}{value}")
    return word if re.fullmatch(r"[\w@%+=:,./…-]+", word) else shlex.quote(word)


def _escaped(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"

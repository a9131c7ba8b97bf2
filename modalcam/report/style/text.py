"""Numbers and texts for people: each number rounded to two digits of its uncertainty, texts made safe to show.

No hidden or reordering characters and no paths of this machine are shown; the templates escape all values and refuse
undefined names.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Any

import jinja2
from markupsafe import Markup

from modalcam.common import escape
from tracker import checked
from tracker.geometry import time_axis

if TYPE_CHECKING:
    from modal_id import IdentifiedMode

MISSING = "–"
MINUS = "−"
_MOST_DECIMALS = 9
_LARGEST = 1e7
_SUPERSCRIPT = str.maketrans("-0123456789.", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹·")


def decimals_of(sd: float) -> int:
    """Decimals that show two significant digits of `sd`; negative left of the point.

    Raises
    ------
    ValueError
        If `sd` is not finite and positive.
    """
    checked("sd", sd, positive=True)
    # The mantissa after rounding decides: 0.0996 to two digits is 0.10, one decimal less than 0.0994.
    return 1 - int(f"{sd:.1e}".partition("e")[2])


def fixed(value: float, decimals: int) -> str:
    """Value with `decimals` decimals, rounded left of the point where that is negative; a dash for NaN."""
    if math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")
    return text.replace("-", MINUS)


def significant(value: float, digits: int = 3) -> str:
    """Value with `digits` significant digits; in powers of ten where it is very small or large."""
    if value == 0.0:
        return "0"
    if not math.isfinite(value):
        return fixed(value, 0)
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    power = int(exponent)
    if -4 <= power < 6:
        return fixed(value, max(digits - 1 - power, 0))
    return f"{mantissa.replace('-', MINUS)} × 10{superscript(power)}"


def with_sd(value: float, sd: float) -> str:
    """``value ± sd``, both to two significant digits of `sd`.

    The value alone, to four digits, where `sd` is NaN, infinite or 0: the number of significant digits is unknown.
    """
    if math.isnan(value):
        return MISSING
    if not (math.isfinite(sd) and sd > 0.0 and math.isfinite(value)):
        return significant(value, 4)
    decimals = decimals_of(sd)
    if decimals > _MOST_DECIMALS or max(abs(value), sd) >= _LARGEST:
        return _scientific(value, sd)
    return f"{fixed(value, decimals)} ± {fixed(sd, decimals)}"


def hertz(frequency_hz: float, sd_hz: float, *, clock_is_known: bool = False) -> str:
    """``value ± sd`` of a frequency, with ``†`` where no ordinary clock is known to the sd and no other is stated."""
    below = not clock_is_known and 0.0 < sd_hz < 1e-6 * time_axis.RATE_SD_PPM["camera header"] * frequency_hz
    return with_sd(frequency_hz, sd_hz) + "†" * below


def in_unit(text: str, unit: str) -> str:
    """A formatted number followed by its unit; alone where it is dimensionless, unit "1"."""
    return text if unit == "1" else f"{text} {unit}"


def interval(low: float, high: float, sd: float) -> str:
    """``low … high`` with the decimals of `with_sd`."""
    if math.isnan(low) or math.isnan(high):
        return MISSING
    if not (math.isfinite(sd) and sd > 0.0):
        return f"{significant(low, 4)} … {significant(high, 4)}"
    decimals = decimals_of(sd)
    if decimals > _MOST_DECIMALS or max(abs(low), abs(high)) >= _LARGEST:
        return f"{significant(low, 4)} … {significant(high, 4)}"
    return f"{fixed(low, decimals)} … {fixed(high, decimals)}"


def percent(ratio: float, digits: int = 2) -> str:
    """Ratio in percent, to `digits` significant digits."""
    return MISSING if math.isnan(ratio) else f"{significant(100.0 * ratio, digits)} %"


def count(number: int, singular: str, plural: str = "") -> str:
    """``1 marker``, ``3 markers``; thousands set apart by a thin space."""
    return f"{thousands(number)} {singular if number == 1 else plural or singular + 's'}"


def thousands(number: int) -> str:
    """Whole number, thousands set apart by a narrow space from 10 000 on."""
    text = f"{abs(number):,}".replace(",", "\u202f") if abs(number) >= 10_000 else str(abs(number))
    return text if number >= 0 else f"{MINUS}{text}"


def signed(value: float, decimals: int) -> str:
    """Value with its sign and `decimals` decimals."""
    text = fixed(value, decimals)
    return f"+{text}" if round(value, decimals) > 0.0 else text


def p_value(value: float, least: float) -> str:
    """Probability with three decimals, or ``< least``."""
    return f"< {least:g}" if value < least else fixed(value, 3)


def odds(log_odds: float) -> str:
    """``12 : 1`` from the natural logarithm of the odds; a power of ten above 10 000."""
    if log_odds < math.log(1e4):
        return f"{significant(math.exp(log_odds), 2)} : 1"
    return f"10{superscript(round(log_odds / math.log(10.0)))} : 1"


def superscript(power: float | str) -> str:
    """Number in superscript characters."""
    return str(power).translate(_SUPERSCRIPT)


def rate(fps: Fraction | None) -> str:
    """``59.94 fps``: frame rate, with the exact fraction where it is not a short decimal; a dash for None."""
    if fps is None:
        return MISSING
    text = f"{float(fps):.6g}"
    exact = Fraction(text) == fps
    return f"{text} fps" if exact else f"{float(fps):.7g} fps ({fps.numerator}/{fps.denominator})"


def listed(words: Sequence[str]) -> str:
    """``a, b and c``."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def mode_name(mode: IdentifiedMode) -> str:
    """``Mode 3``, or its frequency if its number is unknown."""
    if mode.number is None:
        return f"Mode at {significant(mode.frequency_hz, 4)} Hz"
    return f"Mode {mode.number}"


def _scientific(value: float, sd: float) -> str:
    power = math.floor(math.log10(max(abs(value), sd)))
    # Dividing by 10.0**power would underflow to 0 for the smallest doubles.
    scaled, scaled_sd = (
        float(f"{v:.17e}e".partition("e")[0]) * 10.0 ** _shift(v, power) for v in (value, sd)
    )
    decimals = decimals_of(scaled_sd) if scaled_sd > 0.0 else 3
    return f"({fixed(scaled, decimals)} ± {fixed(scaled_sd, decimals)}) × 10{superscript(power)}"


def _shift(value: float, power: int) -> int:
    return int(f"{value:.17e}".partition("e")[2]) - power


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
    return _THOUSANDS.sub("\u202f", "".join(c if c.isprintable() else escape(c) for c in text))


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
    plain = "".join(c if ord(c) <= _LAST_IN_FONT else escape(c) for c in visible(text))
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


_PACKAGE = "modalcam.report"
# Available in templates under their own names: {{ value|fixed(2) }}, {{ value|with_sd(sd) }}.
_FILTERS: tuple[Callable[..., str], ...] = (
    count,
    fixed,
    hertz,
    in_unit,
    interval,
    listed,
    mode_name,
    odds,
    p_value,
    percent,
    rate,
    signed,
    significant,
    superscript,
    thousands,
    with_sd,
    command,
    prose,
    sentence,
)


@cache
def environment(*folders: tuple[str, str]) -> jinja2.Environment:
    """Templates of the report, after those of other packages where there are any.

    Parameters
    ----------
    folders : tuple of (str, str)
        Package and folder in it.
    """
    # Load SciPy and OpenCV, which a run without changes does without.
    from sim.damping import DAMPING_MODELS  # noqa: PLC0415
    from tracker.markers import noun_of  # noqa: PLC0415

    loaders: list[jinja2.BaseLoader] = [jinja2.PackageLoader(*folder) for folder in folders]
    made = jinja2.Environment(
        loader=jinja2.ChoiceLoader([*loaders, jinja2.PackageLoader(_PACKAGE)]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_finalize,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    for text_filter in _FILTERS:
        made.filters[text_filter.__name__] = text_filter
    made.filters["damping"] = DAMPING_MODELS.__getitem__
    made.filters["noun"] = noun_of
    made.tests["finite"] = math.isfinite
    return made


def style_sheet() -> Markup:
    """The one style sheet of all pages."""
    from sim.damping import DAMPING_MODELS  # noqa: PLC0415

    return trusted(environment().get_template("style.css").render(models=DAMPING_MODELS.values()))


def _finalize(value: Any) -> Any:
    """Text with its invisible characters made visible; trusted markup unchanged."""
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value

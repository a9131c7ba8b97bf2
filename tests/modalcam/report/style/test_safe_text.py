import unicodedata
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modalcam.report.style import (
    channel_label,
    command,
    count,
    figure_label,
    prose,
    quantity,
    sentence,
    unbroken,
    visible,
)


@given(st.text(alphabet=st.characters()))
def test_visible_text_has_no_hidden_or_reordering_characters(text):
    shown = visible(text).replace("\u202f", " ")
    assert all(c == " " or c.isprintable() for c in shown)
    assert not any(unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp") for c in shown)


def test_the_space_between_thousands_is_kept_and_no_other():
    assert visible(count(76144, "sample")) == "76\u202f144 samples"
    assert visible("1\u202f234\u202f567") == "1\u202f234\u202f567"
    assert visible("a\u202fb 1\u202f23") == "a\\u202fb 1\\u202f23"


@given(st.text(alphabet=st.characters()))
def test_visible_text_is_legal_xml(text):
    element = ET.Element("title")
    element.text = visible(text)
    written = ET.tostring(element, encoding="unicode")
    assert ET.fromstring(written).text == (visible(text) or None)  # noqa: S314


@given(st.text(alphabet=st.characters()), st.integers(min_value=2, max_value=40))
def test_figure_labels_are_short_and_in_the_font(text, limit):
    label = figure_label(text, limit=limit)
    assert len(label) <= limit
    assert all(ord(c) <= 0x52F or c == "…" for c in label)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("rtl\u202egpj.avi", "rtl\\u202egpj.avi"),
        ("a\nb\tc\x1b", "a\\x0ab\\x09c\\x1b"),
        ("bytes\udcff", "bytes\\udcff"),
        ("nbsp\u00a0", "nbsp\\xa0"),
        ("\ufffe", "\\ufffe"),
        ("café", "café"),
    ],
)
def test_invisible_characters_are_escaped(text, shown):
    assert visible(text) == shown


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("cannot read /home/me/videos/a.avi: gone", "cannot read …/a.avi: gone"),
        ("cannot read '/home/me/a.avi'", "cannot read '…/a.avi'"),
        (r"cannot read C:\Users\me\a.avi", "cannot read …/a.avi"),
        ("in ~/videos/a.avi", "in …/a.avi"),
        ("m/s^2, 30000/1001, sub/a.avi", "m/s^2, 30000/1001, sub/a.avi"),
        ("see https://doi.org/10.1/2", "see https://doi.org/10.1/2"),
    ],
)
def test_folders_are_removed_from_sentences(text, shown):
    assert prose(text) == shown


def test_folders_are_removed_from_command_lines():
    line = "modalcam run '/home/me/my videos' -o /home/me/out --config=/etc/modalcam/a.toml --seed 1"
    assert command(line) == "modalcam run '…/my videos' -o …/out --config=…/a.toml --seed 1"
    assert "/home" not in command("modalcam run '/home/me/unbalanced")


def test_sentences_and_labels():
    assert sentence("no marker was found") == "No marker was found."
    assert sentence("Give --fps!") == "Give --fps!"
    assert sentence("dark") == "Dark."
    assert sentence("a.avi holds no frame") == "a.avi holds no frame."
    assert sentence("mode_1 was lost") == "mode_1 was lost."
    assert sentence("  ") == ""
    assert channel_label("4") == "marker 4"
    assert channel_label("tip") == "tip"


@pytest.mark.parametrize(
    ("unit", "name"),
    [
        ("mm", "displacement"),
        ("px", "displacement"),
        ("1", "displacement"),
        ("m/s^2", "acceleration"),
        ("mm/s²", "acceleration"),
        ("g", "acceleration"),
        ("m/s", "velocity"),
    ],
)
def test_a_series_is_called_what_its_unit_says(unit, name):
    assert quantity(unit) == name


def test_numbers_stay_with_their_units_and_comparisons_and_the_rest_is_unchanged():
    page = (
        '<p title="1 mm">ζ = 1.0 % at 27.0 Hz (p &lt; 0.003), 3 times 2.9 mm in 3 modes.</p><pre>1 mm</pre>'
    )
    told = unbroken(page)
    assert told.replace("\u00a0", " ") == page
    parts = [part.rstrip(",.) ") for part in told.partition(">")[2].partition("</p>")[0].split(" ")]
    assert parts == [
        "ζ\u00a0=\u00a01.0\u00a0%", "at", "27.0\u00a0Hz", "(p\u00a0&lt;\u00a00.003", "3", "times",
        "2.9\u00a0mm", "in", "3", "modes",
    ]  # fmt: skip
    assert told.startswith('<p title="1 mm">')
    assert told.endswith("<pre>1 mm</pre>")

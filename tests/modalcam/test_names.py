import unicodedata

from hypothesis import given
from hypothesis import strategies as st

from modalcam.common import csv_safe, natural_key, recording_names, shown

file_names = st.text(st.characters(exclude_characters="/\0"), min_size=1, max_size=60)


def test_plain_stems_are_unchanged():
    assert recording_names(["mode1.avi", "b/take_2.mp4"]) == ("mode1", "take_2")


@given(st.lists(file_names, unique=True, max_size=8))
def test_names_are_unique_safe_and_independent_of_order(files):
    names = recording_names(files)
    folded = [unicodedata.normalize("NFKC", name).casefold() for name in names]
    assert len(set(folded)) == len(files)
    for name in names:
        assert name.isascii()
        assert 0 < len(name) <= 90
        assert not set(name) & set('/\\:*?"<>|\n\t ')
        assert name[0] not in ".-"
    turned = files[::-1]
    assert dict(zip(files, names, strict=True)) == dict(zip(turned, recording_names(turned), strict=True))


def test_equal_stems_get_different_names():
    names = recording_names(["a.mp4", "a.avi", "x/A.mp4"])
    assert len({name.lower() for name in names}) == 3


def test_reserved_and_hidden_names_are_replaced():
    for bad in ["CON.mp4", "..avi", "-v.mp4", "a b.mp4", "%02d?.mp4", "=cmd|x.mp4"]:
        (name,) = recording_names([bad])
        assert name not in ("CON", "..", "-v", "a b")
        assert name[0].isalnum()


@given(st.text())
def test_shown_text_has_no_control_characters(text):
    for c in shown(text):
        assert unicodedata.category(c) not in ("Cc", "Cf", "Cs", "Zl", "Zp")


def test_formulas_are_escaped_in_csv():
    assert csv_safe("=1+1") == "'=1+1"
    assert csv_safe("plain") == "plain"


def test_natural_order():
    names = ["frame10", "frame2", "frame1"]
    assert sorted(names, key=natural_key) == ["frame1", "frame2", "frame10"]


@given(st.lists(st.text(max_size=8)))
def test_natural_order_is_total(names):
    once = sorted(names, key=natural_key)
    backwards = once[::-1]
    assert sorted(backwards, key=natural_key) == once

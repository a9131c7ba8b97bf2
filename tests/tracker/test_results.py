"""How much of a declared recording was decoded, in words."""

import pytest

from tracker import DecodeReport


def report(declared, decoded, corrupt=0):
    return DecodeReport("mjpeg", "gray", 64, 48, 8, declared, decoded, corrupt, lossy=True)


def test_a_cut_file_states_frames_and_times():
    assert report(1301, 137, corrupt=1).cut_off(500.0) == (
        "the file is cut off: 138 of the 1301 frames that it declares could be read, 0.276 s of 2.602 s"
    )


def test_without_a_rate_there_are_no_times():
    assert report(1301, 138).cut_off(None).endswith("138 of the 1301 frames that it declares could be read")


@pytest.mark.parametrize(
    ("declared", "decoded", "corrupt"),
    [(0, 138, 0), (138, 138, 0), (138, 100, 38), (100, 138, 0), (20, 18, 0), (1000, 990, 0)],
    ids=["not declared", "complete", "damaged frames", "more than declared", "two of 20", "1 %"],
)
def test_a_file_that_misses_nothing_worth_mentioning_is_not_cut_off(declared, decoded, corrupt):
    assert report(declared, decoded, corrupt).cut_off(500.0) == ""

"""A sample film whose file ends after 138 of its 1301 frames: the cut is the first reason of what is missing."""

import json
import re

import av
import pytest
from support.command import invoked
from support.html_page import Page
from support.paths import SAMPLES

READ, DECLARED, FPS = 138, 1301, 500


@pytest.fixture(scope="module")
def cut_film(tmp_path_factory):
    """A folder with the first bytes of mode4.avi, which is driven for 0.4 s, and its entry in experiment.toml."""
    folder = tmp_path_factory.mktemp("cut")
    film = SAMPLES / "mode4.avi"
    with av.open(str(film)) as container:
        begins = [packet.pos for packet in container.demux(video=0) if packet.size]
    (folder / film.name).write_bytes(film.read_bytes()[: begins[READ]])
    common, *recordings = (SAMPLES / "experiment.toml").read_text().split("[[recordings]]")
    own = next(text for text in recordings if film.name in text)
    (folder / "experiment.toml").write_text(f"{common}[[recordings]]{own}")
    return folder


def test_a_cut_film_says_so_first_in_terminal_and_report(cut_film, tmp_path, in_process, no_figures):
    result = invoked("run", cut_film, "-o", tmp_path / "out", "--jobs", 1)
    assert result.exit_code == 4
    counts = f"{READ} of the {DECLARED} frames that it declares could be read, 0.276 s of 2.602 s"
    said = " ".join(result.stderr.split())
    assert (
        f"NOT IDENTIFIED mode4.avi: the file is cut off: {counts}; the record needs at least 0.188 s" in said
    )
    (recording,) = json.loads((tmp_path / "out" / "summary.json").read_text())["recordings"]
    (missing,) = (mode for mode in recording["failed_modes"] if mode["target"])
    needed = re.search(r"at least ([\d.]+) s \(10 cycles at", missing["reason"])
    true_hz = 53.2
    assert float(needed[1]) == pytest.approx(10.0 / true_hz, rel=0.01)
    words = " ".join(Page((tmp_path / "out" / "report.html").read_text()).words.split())
    first_screen = words.partition("Contents")[0].partition("Unfold all")[0]
    assert f"First of 2 failed checks : The file is cut off: {counts} (mode4)" in first_screen.replace(
        "checks:", "checks :"
    )

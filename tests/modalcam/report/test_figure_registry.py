"""The registry of figures: its order, its cache, a figure of a plugin; the criterion of the shape that is drawn."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from kit import runs

from modalcam.pipeline import Cache, Progress, worker_pool
from modalcam.report import build_report, draw_figures
from modalcam.report.figures import (
    FIGURES,
    FigureKind,
    RecordingSubject,
    base,
    figures_of,
    register_figure,
    shape_of,
)


@pytest.fixture
def drawn(monkeypatch):
    """Keys of the figures drawn in the test; drawing is replaced by a placeholder."""
    keys = []

    def recorded(self, shown):
        keys.append(self.key)
        return f'<svg viewBox="0 0 1 1" role="img"><path d="M0 0h{len(keys)}"/></svg>'

    monkeypatch.setattr(FigureKind, "_drawn", recorded)
    return keys


@pytest.fixture
def toy():
    def draw(figure, shown):
        figure.subplots().plot(shown)

    kind = FigureKind(
        key="toy",
        place="tracking",
        shows=lambda subject: subject.recording.tracks.x_px[:, 0],
        draw=draw,
        words='{% set title = "Toy figure" %}{% macro alt(shown) %}A line.{% endmacro %}'
        "{% macro caption(shown) %}{{ shown.size }} samples.{% endmacro %}",
    )
    register_figure(kind)
    yield kind
    del FIGURES["toy"]


def short_run(**change):
    recordings = runs.compared([runs.recording(0, seconds=1.0)])
    return runs.run_result([replace(r, **change) for r in recordings])


def test_a_second_report_is_identical_and_draws_nothing(tmp_path, drawn):
    first = build_report(short_run(), Cache(tmp_path))
    assert len(drawn) > 5
    drawn.clear()
    assert build_report(short_run(), Cache(tmp_path)) == first
    assert drawn == []


@pytest.mark.usefixtures("toy")
def test_workers_draw_what_is_missing_and_the_report_is_the_same(tmp_path, monkeypatch, build):
    """As the report of `build`, whose figures are drawn without workers, here or by other tests of the same run."""
    named = []
    progress = Progress()
    monkeypatch.setattr(progress, "advance", lambda name, *, reused=False: named.append((name, reused)))
    result = short_run()
    with worker_pool(1) as pool:
        draw_figures(result, tmp_path, pool, progress, iter(()))
        assert pool.failures == 0
        assert ("decay", False) in named
        first = len(named)
        # The worker does not know the figure that only this process has registered: it is the one left to draw.
        draw_figures(result, tmp_path, pool, progress, iter(()))
    assert named[first:] == [("toy", False)]
    alone = build(result)
    drawn = []
    draw = FigureKind._drawn
    monkeypatch.setattr(FigureKind, "_drawn", lambda self, shown: drawn.append(self.key) or draw(self, shown))
    assert build_report(result, Cache(tmp_path)) == alone
    assert drawn == ["toy"]


def test_a_change_redraws_only_the_figures_that_show_it(tmp_path, drawn):
    build_report(short_run(), Cache(tmp_path))
    drawn.clear()
    tracks = short_run().recordings[0].tracks
    guessed = replace(tracks, time_axis=runs.PLAYBACK)
    page = build_report(short_run(tracks=guessed, name="other"), Cache(tmp_path))
    assert "The time axis is a playback rate" in page
    assert drawn == ["extremes"], "it has the name of the recording"
    drawn.clear()
    build_report(short_run(tracks=replace(tracks, sd_x_px=2.0 * tracks.sd_x_px)), Cache(tmp_path))
    assert drawn == ["tracking"]


def test_without_a_cache_every_figure_is_drawn(drawn):
    build_report(short_run())
    once = list(drawn)
    build_report(short_run())
    assert drawn == once + once


def test_the_cache_depends_on_data_code_and_matplotlib(toy, monkeypatch):
    shown = np.arange(3.0)
    key = toy.cache_key(shown)
    assert toy.cache_key(np.arange(3.0)) == key
    assert toy.cache_key(np.arange(4.0)) != key
    assert replace(toy, height_in=3.0).cache_key(shown) != key
    other = replace(toy, draw=FIGURES["decay"].draw)
    assert other.cache_key(shown) != key
    monkeypatch.setattr(base, "_matplotlib_version", lambda: "0.0")
    assert toy.cache_key(shown) != key


@pytest.mark.usefixtures("toy", "drawn")
def test_a_figure_of_a_plugin_is_in_the_report():
    page = build_report(short_run())
    assert '<figure id="r1-toy">' in page
    assert "Toy figure" in page
    assert "500 samples." in page


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"key": "decay"}, "not in"), ({"key": "A b"}, "lower-case"), ({"key": "b", "place": "top"}, "place")],
)
def test_keys_and_places_are_checked(toy, change, reason):
    with pytest.raises(ValueError, match=reason):
        register_figure(replace(toy, **change))


def test_figures_without_data_are_omitted():
    empty = RecordingSubject(replace(runs.recording(0), tracks=None, series=None, identification=None))
    assert list(figures_of("recording", empty, "r1")) == []
    assert list(figures_of("tracking", empty, "r1")) == []


def test_the_assurance_criterion_is_that_of_the_drawn_curve():
    """That of the mode is with the configured beam; the curve may be of the updated one."""
    recording = runs.recording(0, number=2)
    found = recording.identification
    modes = tuple(replace(mode, mac=0.342) for mode in found.modes)
    recording = replace(recording, identification=replace(found, modes=modes))
    shown = shape_of(RecordingSubject(recording, runs.beam_theory()))
    # Linear interpolation of 121 points of mode 2 errs by under 1e-3 of its largest value.
    at_markers = np.interp(shown.position_mm, *shown.curve)
    expected = abs(np.vdot(shown.shape, at_markers)) ** 2
    expected /= np.vdot(shown.shape, shown.shape).real * np.vdot(at_markers, at_markers).real
    assert shown.mac == pytest.approx(expected, abs=1e-3)
    assert shown.mac > 0.99
    assert shape_of(RecordingSubject(recording)).mac != shown.mac, "unknown without theory"


@pytest.mark.parametrize("row", [3, -9])
def test_an_outlier_does_not_set_the_scale_of_the_decay(row):
    """One sample a hundred times as large as the motion, before the onset or rejected by the fit."""
    recording = runs.recording(0)
    found = recording.identification
    largest = np.nanmax(np.abs(found.series.values), axis=0)
    values, used = found.series.values.copy(), found.used.copy()
    values[row], used[row] = 100.0 * largest, False
    found = replace(found, series=replace(found.series, values=values), used=used)
    shown = RecordingSubject(replace(recording, series=found.series, identification=found))
    figure = plt.figure()
    FIGURES["decay"].draw(figure, FIGURES["decay"].shows(shown))
    for axes, size in zip(figure.axes[:-1], largest, strict=True):
        assert np.ptp(axes.get_ylim()) < 3.0 * size, "the motion fills less than two thirds"
    plt.close(figure)

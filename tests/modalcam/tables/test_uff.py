"""Universal files, read and written by pyuff for comparison."""

from dataclasses import replace

import numpy as np
import pytest
from kit.identified import identification_of

from modalcam import __version__
from modalcam.common import InputError
from modalcam.inputs import read_uff
from modalcam.tables import write_uff

pyuff = pytest.importorskip("pyuff", reason="the extra modalcam[uff] is not installed")


def test_pyuff_reads_the_series_and_shapes(tmp_path):
    found = identification_of(fps=600.0)
    path = tmp_path / "take.uff"
    write_uff(path, found)
    sets = pyuff.UFF(str(path)).read_sets()
    assert sets[0]["type"] == 151, "the header stands first"
    assert sets[0]["model_name"].strip() == found.series.name
    assert sets[0]["description"].strip() == f"3 channels in mm, {len(found.modes)} modes"
    assert sets[0]["program"].strip() == f"modalcam {__version__}"
    functions = [one for one in sets if one["type"] == 58]
    assert [one["rsp_ent_name"].strip() for one in functions] == list(found.series.channels)
    assert [one["rsp_node"] for one in functions] == [1, 2, 3]
    for k, one in enumerate(functions):
        finite = np.isfinite(found.series.values[:, k])
        # Thirteen columns have ten decimals for times below 10 s; the increment at 600 fps has eight digits.
        np.testing.assert_allclose(one["x"], found.series.time_s[finite], rtol=3e-8, atol=1e-10)
        np.testing.assert_allclose(one["data"], found.series.values[finite, k], rtol=1e-11)
        assert one["func_type"] == 1
        assert one["ordinate_spec_data_type"] == 8
        assert one["abscissa_spec_data_type"] == 17
        assert one["rsp_dir"] == 1
        assert one["ordinate_axis_units_lab"].strip() == "mm"
    shapes = [one for one in sets if one["type"] == 55]
    assert len(shapes) == len(found.modes)
    for one, mode in zip(shapes, found.modes, strict=True):
        assert one["mode_n"] == mode.number
        # Dataset 55 has six digits.
        assert abs(one["eig"]) / (2.0 * np.pi) == pytest.approx(mode.frequency_hz, rel=1e-5)
        assert -one["eig"].real / abs(one["eig"]) == pytest.approx(mode.damping_ratio, rel=2e-5)
        np.testing.assert_allclose(one["r1"], mode.shape, rtol=2e-5, atol=1e-5 * mode.amplitude)
        np.testing.assert_array_equal(one["node_nums"], [1, 2, 3])


def test_nodes_lie_at_their_positions_across_the_motion(tmp_path):
    found = identification_of(fps=600.0)
    path = tmp_path / "take.uff"
    write_uff(path, found)
    sets = {one["type"]: one for one in pyuff.UFF(str(path)).read_sets()}
    nodes, units = sets[15], sets[164]
    points_m = np.column_stack([nodes["x"], nodes["y"], nodes["z"]]) / units["length"]
    np.testing.assert_allclose(np.linalg.norm(points_m, axis=1), 1e-3 * found.series.positions_mm, rtol=1e-4)
    shape = np.array([sets[55]["r1"][-1], sets[55]["r2"][-1], 0.0])
    assert abs(points_m[-1] @ shape) < 1e-6 * np.linalg.norm(points_m[-1]) * np.linalg.norm(shape)

    nowhere = replace(found.series, positions_mm=np.full(3, np.nan))
    write_uff(path, replace(found, series=nowhere))
    assert {one["type"] for one in pyuff.UFF(str(path)).read_sets()} == {55, 58, 151}


@pytest.mark.parametrize("fps", [500.0, 600.0, 30000.0 / 1001.0])
def test_round_trip_of_the_series(tmp_path, fps):
    found = identification_of(fps=fps)
    path = tmp_path / "take.uff"
    write_uff(path, found)
    series = read_uff(path, name="take", unit="?", positions_mm=(10.0, 20.0, 30.0))
    np.testing.assert_allclose(series.time_s, found.series.time_s, rtol=3e-8, atol=1e-10)
    np.testing.assert_allclose(series.values, found.series.values, rtol=1e-11)
    assert series.unit == "mm"
    assert series.channels == found.series.channels
    assert series.positions_mm.tolist() == [10.0, 20.0, 30.0]


def function(node, time_s, values, **more):
    given = {"func_type": 1, "rsp_node": node, "rsp_dir": 3, "abscissa_spacing": 1}
    zeros = ("ref_node", "ref_dir", "orddenom_spec_data_type", "z_axis_spec_data_type")
    given |= dict.fromkeys(zeros, 0) | {"ordinate_axis_units_lab": "m/s^2"}
    given |= {"abscissa_spec_data_type": 17, "ordinate_spec_data_type": 12}
    return pyuff.prepare_58(binary=0, data=values, x=time_s, **(given | more))


def test_accelerations_from_other_software(tmp_path):
    path = tmp_path / "acc.uff"
    time_s = np.arange(100) * 0.01
    sets = [function(4, time_s, np.sin(time_s)), function(7, time_s[::2], np.cos(time_s[::2]))]
    pyuff.UFF(str(path)).write_sets(sets, "overwrite")
    series = read_uff(path, name="acc", unit="1")
    assert series.channels == ("node4", "node7")
    assert series.unit == "m/s^2"
    assert "acceleration" in series.notes[0]
    np.testing.assert_allclose(series.values[:, 0], np.sin(time_s), atol=1e-10)
    np.testing.assert_allclose(series.values[::2, 1], np.cos(time_s[::2]), atol=1e-10)
    assert np.all(np.isnan(series.values[1::2, 1]))


@pytest.mark.parametrize(
    ("sets", "reason"),
    [
        ([function(1, np.arange(20) * 0.1, np.ones(20), func_type=4)], "found none"),
        (
            [
                function(1, np.arange(20) * 0.1, np.ones(20)),
                function(2, np.arange(20) * 0.1, np.ones(20), ordinate_axis_units_lab="g"),
            ],
            "found g, m/s",
        ),
        ([function(1, np.arange(3) * 0.1, np.ones(3))], "at least 8 samples"),
        ([function(1, -np.arange(20) * 0.1, np.ones(20), abscissa_spacing=0)], "times that increase"),
    ],
)
def test_unusable_files_are_rejected_with_a_reason(tmp_path, sets, reason):
    path = tmp_path / "bad.uff"
    pyuff.UFF(str(path)).write_sets(sets, "overwrite")
    with pytest.raises(InputError, match=reason):
        read_uff(path, name="bad", unit="1")


@pytest.mark.parametrize("content", ["", "no universal file\n", "    -1\n    58\nbroken\n    -1\n"])
def test_damaged_files_are_rejected(tmp_path, content):
    path = tmp_path / "bad.uff"
    path.write_text(content)
    with pytest.raises(InputError):
        read_uff(path, name="bad", unit="1")


def test_the_same_series_gives_the_same_bytes(tmp_path):
    found = identification_of(fps=500.0)
    for name in ("a.uff", "b.uff"):
        write_uff(tmp_path / name, found)
    assert (tmp_path / "a.uff").read_bytes() == (tmp_path / "b.uff").read_bytes()


def test_a_channel_without_values_is_omitted(tmp_path):
    found = identification_of(fps=500.0)
    values = found.series.values.copy()
    values[:, 1] = np.nan
    found = replace(found, series=replace(found.series, values=values))
    write_uff(tmp_path / "a.uff", found)
    assert read_uff(tmp_path / "a.uff", name="a", unit="1").channels == ("m0", "m2")


@pytest.mark.usefixtures("in_process", "no_figures")
def test_identify_reads_a_universal_file(tmp_path):
    """The command gives the same modes from .uff and .csv files of the same series."""
    from modalcam.commands import Options, identify
    from modalcam.config import RecordingConfig
    from modalcam.pipeline import Progress

    rng = np.random.default_rng(3)
    time_s = np.arange(1500) / 500.0
    pole = 2.0 * np.pi * 26.84 * (-0.0028 + 1j)
    values = np.exp(pole * time_s).real + 1e-3 * rng.standard_normal(time_s.size)
    uff, csv = tmp_path / "a.uff", tmp_path / "a.csv"
    pyuff.UFF(str(uff)).write_sets([function(1, time_s, values)], "overwrite")
    table = np.column_stack([time_s, values])
    np.savetxt(csv, table, delimiter=",", header="time_s,node1", comments="", fmt="%.12g")
    modes = []
    for path in (uff, csv):
        out = tmp_path / f"out{path.suffix}"
        options = Options(out=out, config=None, seed=0, jobs=1, force=False, follow_symlinks=False)
        result = identify(path, options, Progress(), unit="m/s^2", recording=RecordingConfig(file=path.name))
        modes.append(result.recordings[0].identification.target)
        assert (out / "universal" / "a.uff").exists()
    assert modes[0].amplitude_unit == "m/s^2"
    assert modes[0].frequency_hz == pytest.approx(modes[1].frequency_hz, abs=0.2 * modes[1].frequency_sd_hz)

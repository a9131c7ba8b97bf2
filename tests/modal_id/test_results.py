"""Tables, plots and short representations of results; quantiles from the stored draws."""

from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from kit.identified import identification

from modal_id import MODE_COLUMNS, DrivenMotion

mpl.use("Agg")


@pytest.fixture
def found():
    time_s = np.arange(500) / 250.0
    modes = [(10.0, 0.003, np.array([0.4, 1.0]), 2), (1.8, 0.01, np.array([0.1, 0.2]), 1)]
    return identification(modes, time_s=time_s, positions_mm=np.array([200.0, 490.0]), fit_from_s=0.2)


def test_quantiles_are_computed_from_the_draws(found):
    mode, draws = found.target, found.target.posterior
    assert mode.frequency_hz == np.median(draws.frequency_hz)
    assert mode.damping_ratio_sd == np.std(draws.damping_ratio)
    assert mode.damping_interval() == tuple(np.quantile(draws.damping_ratio, [0.05, 0.95]))
    assert mode.frequency_interval_hz(0.99) == tuple(np.quantile(draws.frequency_hz, [0.005, 0.995]))
    with pytest.raises(ValueError, match="between 0 and 1"):
        mode.damping_interval(90.0)


def test_table_columns_match_modes_csv(found):
    table = found.to_dataframe()
    assert table.columns.tolist() == [column.name for column in MODE_COLUMNS]
    assert table["mode"].tolist() == [2, 1]
    assert table["n_samples"].tolist() == [450, 450]
    assert table["damping_ratio_q95"][0] == found.modes[0].damping_interval()[1]
    unnumbered = replace(found, modes=(replace(found.modes[0], number=None, flags=("LOW_SNR", "HARMONIC")),))
    assert unnumbered.to_dataframe()["mode"].isna().all()
    assert unnumbered.to_dataframe()["flags"].tolist() == ["LOW_SNR|HARMONIC"]
    assert tuple(replace(found, modes=()).to_dataframe().columns) == tuple(table.columns)
    assert len(found.target.to_dataframe()) == 1


def test_plots_return_the_axes_they_draw_on(found):
    axes = found.plot()
    assert axes.get_xlabel() == "time (s)"
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), found.series.values[:, 1], "the tip moves most")
    assert found.plot(axes) is axes
    assert found.target.plot().get_xlabel() == "damping ratio at 10 Hz"
    assert len(found.target.posterior.plot().lines) == 1
    assert len(replace(found, modes=()).plot().lines) == 2
    gaps = np.where(np.arange(found.series.time_s.size)[:, None] % 10 == 0, np.nan, found.series.values)
    line = DrivenMotion(10.0, 0.01, 1.0, found.series.unit)
    none = replace(found.onset, source="none")
    driven = replace(found, series=replace(found.series, values=gaps), modes=(), driven=(line,), onset=none)
    assert [drawn.get_label() for drawn in driven.plot().lines] == ["measured", "fitted motion"]
    mpl.pyplot.close("all")


def test_representations_are_short_and_contain_no_arrays(found):
    assert repr(found).splitlines()[0] == "Identification of 'made': 2 modes, free decay from 0.2 s"
    assert "mode 2 (target): 10 Hz (sd 0.0001), damping ratio 0.003 (sd 1.5e-05)" in repr(found)
    assert len(repr(found.target.posterior)) < 100
    for one in (found, found.target, found.target.posterior):
        assert "array" not in repr(one)
        assert one._repr_html_().startswith("<p>")
    hostile = replace(found, series=replace(found.series, name="<script>"))
    assert "<script>" not in hostile._repr_html_()

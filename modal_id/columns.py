"""Columns of ``modes.csv`` and names of the values of a mode in ``summary.json``.

``modalcam/tables/summary.py`` takes them by group; ``tests/integration/test_sample_videos_run.py`` states the header.
Without NumPy: the command prints a run that is up to date by these names.
"""

from __future__ import annotations

from tracker import Column

IDENTITY = (
    Column("mode", "", "number of the beam's mode, from 1; empty where unknown", lambda mode: mode.number),
    Column("target", "", "whether the recording was made for this mode"),
)
FREQUENCY = (
    Column("frequency_hz", "Hz", "natural frequency ω/2π of Eq. 1, mean over the record: posterior median"),
    Column("frequency_sd_hz", "Hz", "its posterior standard deviation"),
)
FREQUENCY_INTERVAL = (
    Column("frequency_q05_hz", "Hz", "5 % quantile", lambda mode: mode.frequency_interval_hz()[0]),
    Column("frequency_q95_hz", "Hz", "95 % quantile", lambda mode: mode.frequency_interval_hz()[1]),
)
DAMPING = (
    Column("damping_ratio", "1", "damping ratio ζ of Eq. 1, mean over the record: posterior median"),
    Column("damping_ratio_sd", "1", "its posterior standard deviation"),
)
DAMPING_INTERVAL = (
    Column("damping_ratio_q05", "1", "5 % quantile", lambda mode: mode.damping_interval()[0]),
    Column("damping_ratio_q95", "1", "95 % quantile", lambda mode: mode.damping_interval()[1]),
)
SMALL_FREQUENCY = (
    Column(
        "frequency_small_amplitude_hz",
        "Hz",
        "limit of the frequency at zero amplitude",
        lambda mode: mode.small_amplitude_frequency[0],
    ),
    Column(
        "frequency_small_amplitude_sd_hz",
        "Hz",
        "its standard deviation",
        lambda mode: mode.small_amplitude_frequency[1],
    ),
)
SMALL_DAMPING = (
    Column(
        "damping_ratio_small_amplitude",
        "1",
        "limit of the damping ratio at zero amplitude",
        lambda mode: mode.small_amplitude_damping[0],
    ),
    Column(
        "damping_ratio_small_amplitude_sd",
        "1",
        "its standard deviation",
        lambda mode: mode.small_amplitude_damping[1],
    ),
)
AMPLITUDE = (
    Column(
        "amplitude",
        "amplitude_unit",
        "largest amplitude of a marker where the fit begins, corrected for exposure",
    ),
    Column("amplitude_unit", "", "mm or px"),
)
OF_MODE = (
    *IDENTITY,
    *FREQUENCY,
    *FREQUENCY_INTERVAL,
    *DAMPING,
    *DAMPING_INTERVAL,
    *SMALL_FREQUENCY,
    *SMALL_DAMPING,
    *AMPLITUDE,
)
# Of the whole identification: the same in each row of a recording.
OF_RECORD = (
    Column("onset_s", "s", "start of the free decay", lambda found: found.onset.time_s),
    Column("n_samples", "1", "frames that the fit used", lambda found: int(found.used.any(axis=1).sum())),
    Column("n_markers", "1", "markers that the fit used", lambda found: int(found.channels_used.sum())),
)
FLAGS = Column(
    "flags", "", "names of the mode's flags, joined by a vertical bar", lambda mode: "|".join(mode.flags)
)
MODE_COLUMNS = (*OF_MODE, *OF_RECORD, FLAGS)

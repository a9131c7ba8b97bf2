"""Result of a run over a folder, from which the report and every file in OUT are made.

The classes of the single results are imported when they are needed only: a run that is up to date loads none of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from modalcam.common import csv_safe, shown

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.axes import Axes

    from modal_id import Identification
    from sim.beam import BeamModes, BeamProperties
    from sim.comparison import DecayComparison
    from sim.damping import LawComparison
    from sim.updating import Updating
    from tracker import DisplacementSeries, FailedTracking, Failure, MarkerTracks

# Name of the file of each stage of the core and the field of a recording that its result fills.
STAGE_FIELDS = {"tracks": "tracks", "modes": "identification", "comparison": "comparison"}
# Name of the saved results of a run as a whole; names of recordings never begin with a dot.
RUN = ".beam"


@dataclass(frozen=True)
class RecordingResult:
    """Results of one recording; that of a stage that was not reached is None.

    Attributes
    ----------
    name : str
        Name of the recording in every file of OUT, unique in the run and safe as a file name.
    file : str
        Path relative to the folder, unescaped.
    sha256 : str
        Of the file's bytes; empty if it could not be read.
    mode : int or None
        The mode that was excited, as configured.
    tracks, series, identification, comparison :
        Results of the stages; a failure is a falsy value with its reason.
    added : mapping of str to result
        Those of the stages that apps and plugins add, by the name of the stage's file.
    path : Path or None
        Where the recording is; None for a series, and for a result read from OUT.
    """

    name: str
    file: str
    sha256: str
    mode: int | None
    tracks: MarkerTracks | FailedTracking | None = None
    series: DisplacementSeries | None = None
    identification: Identification | Failure | None = None
    comparison: DecayComparison | Failure | None = None
    added: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = field(default=None, compare=False)

    @property
    def identified(self) -> Identification | None:
        """The identification, unless it failed or was not reached."""
        return cast("Identification", self.identification) if self.identification else None

    @property
    def failure(self) -> str:
        """Reason why no mode was identified; empty if one was."""
        if self.tracks is not None and not self.tracks:
            return cast("FailedTracking", self.tracks).reason
        if self.identification is not None and not self.identification:
            return cast("Failure", self.identification).reason
        found = self.identified
        if found is not None and not found.motions:
            return "; ".join(mode.reason for mode in found.failed) or "no mode was found"
        return ""

    def to_dataframe(self) -> pd.DataFrame:
        """Identified modes with the columns of `modes.csv`, one row for each."""
        return mode_table((self,))

    def __repr__(self) -> str:
        """Name and outcome in one line."""
        if self.failure:
            return f"<RecordingResult {shown(self.name)}: {self.failure}>"
        modes = () if self.identified is None else self.identified.motions
        found = ", ".join(f"{mode.frequency_hz:.4g} Hz" for mode in modes)
        return f"<RecordingResult {shown(self.name)}: {found or 'not identified'}>"

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(index=False, float_format="%.5g"))


@dataclass(frozen=True)
class BeamResult:
    """The beam before and after updating.

    `standard_modes` are about the equilibrium under gravity; `updated` is None if the beam could not be matched to the
    measured modes, with the reason in `note`; Rayleigh's coefficients are those of Eq. 4 from the two lowest measured
    modes, NaN if fewer than two were measured; `laws` is None where no measured mode could be numbered.
    """

    standard: BeamProperties
    standard_modes: BeamModes
    updated: Updating | None = None
    updated_modes: BeamModes | None = None
    rayleigh_alpha_1_s: float = float("nan")
    rayleigh_beta_s: float = float("nan")
    note: str = ""
    laws: LawComparison | Failure | None = None


@dataclass(frozen=True)
class RunResult:
    """Everything that a run found.

    Attributes
    ----------
    folder : str
        Name of the folder of the recordings.
    recordings : tuple of RecordingResult
        In natural order of their files.
    beam : BeamResult or None
        None without a usable ``[beam]``.
    not_done : tuple of str
        Steps that were skipped and the reasons, each a full sentence.
    resolved_config : str
        The configuration as resolved, in TOML.
    internal_errors : int
        Tasks that failed because of an error in the program.
    added : mapping of str to result
        Those of the stages beside "run", by the name of the stage's file.
    """

    folder: str
    recordings: tuple[RecordingResult, ...]
    beam: BeamResult | None
    not_done: tuple[str, ...]
    resolved_config: str
    versions: tuple[tuple[str, str], ...]
    command_line: str
    seed: int
    internal_errors: int = 0
    added: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def saved(cls, load: Callable[[], dict[str, Any]], **fields: Any) -> RunResult:
        """Result of which the fields that are not given come from `load` when one of them is first used."""
        result = object.__new__(cls)
        for name, value in {"internal_errors": 0, **fields, "_load": load}.items():
            object.__setattr__(result, name, value)
        return result

    def __getattr__(self, name: str) -> Any:
        """Load what a saved result has not loaded yet."""
        if name not in self.__dataclass_fields__ or "_load" not in self.__dict__:
            raise AttributeError(name)
        for key, value in self.__dict__["_load"]().items():
            object.__setattr__(self, key, value)
        return self.__dict__[name]

    def __getitem__(self, name: str) -> RecordingResult:
        """The recording of this name; KeyError, with the names there are, without one."""
        for recording in self.recordings:
            if recording.name == name:
                return recording
        msg = f"{name}: no recording of that name; there are {', '.join(one.name for one in self.recordings)}"
        raise KeyError(msg)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Damping ratios over the frequencies of the modes with 90 % intervals, a colour for each recording."""
        import numpy as np  # noqa: PLC0415 - loaded when used

        from modal_id import axes_or_new  # noqa: PLC0415 - loaded when used

        axes = axes_or_new(ax)
        for recording in self.recordings:
            modes = () if recording.identified is None else recording.identified.modes
            at_hz = [mode.frequency_hz for mode in modes]
            (points,) = axes.plot(at_hz, [mode.damping_ratio for mode in modes], "o", label=recording.name)
            bounds = np.array([mode.damping_interval() for mode in modes]).reshape(-1, 2)
            axes.vlines(at_hz, *bounds.T, color=points.get_color())
        axes.set(xlabel="natural frequency (Hz)", ylabel="damping ratio", xscale="log", yscale="log")
        axes.legend()
        return axes

    def to_dataframe(self) -> pd.DataFrame:
        """Identified modes of all recordings with the columns of `modes.csv`, one row for each mode."""
        return mode_table(self.recordings)

    def to_xarray(self) -> xarray.DataTree:
        """Posterior draws of all recordings: a node for each, with the groups of its file in ``posterior/``.

        ArviZ uses the node of a recording as it is; before version 1, `arviz.from_datatree` makes an `InferenceData` of
        it. A recording without modes has no node. ImportError without xarray.

        Examples
        --------
        >>> posterior = result.to_xarray()["take/posterior"].to_dataset()  # doctest: +SKIP
        """
        from modalcam.pipeline.draws import data_tree  # noqa: PLC0415 - loaded when used

        return data_tree(self.recordings)

    def __repr__(self) -> str:
        """Folder, then one line for each recording."""
        lines = "".join(f"\n  {recording!r}" for recording in self.recordings)
        return f"<RunResult {shown(self.folder)}: {len(self.recordings)} recordings>{lines}"

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(index=False, float_format="%.5g"))


def mode_table(recordings: Iterable[RecordingResult]) -> pd.DataFrame:
    """Identified modes of recordings with the columns of `modes.csv`; `mode` is empty where its number is unknown."""
    import pandas as pd  # noqa: PLC0415 - loaded when used

    from modal_id import MODE_COLUMNS  # noqa: PLC0415 - loaded when used

    columns = ["recording", *(column.name for column in MODE_COLUMNS)]
    frames = [pd.DataFrame(columns=pd.Index(columns))]
    for recording in recordings:
        found = recording.identified
        if found is not None and found.motions:
            frame = found.to_dataframe()
            frame.insert(0, "recording", csv_safe(recording.name))
            frames.append(frame.astype({"mode": object}).fillna({"mode": ""}))
    return pd.concat(frames[1:] or frames, ignore_index=True)[columns]

"""What one run over a folder gives: the input of the report and of every file in OUT."""

from __future__ import annotations

from dataclasses import dataclass

from modal_id.results import FailedIdentification, Identification
from modalcam.video.results import KeptFrames, NoKeptFrames, NoSimulatedFootage, SimulatedFootage
from sim.beam.modes import BeamModes
from sim.beam.properties import BeamProperties
from sim.comparison import DecayComparison, FailedComparison
from sim.updating import Updating
from tracker.results import DisplacementSeries, FailedTracking, MarkerTracks


@dataclass(frozen=True)
class RecordingResult:
    """One recording through all stages; a stage that was not reached is None.

    Attributes
    ----------
    name : str
        Name of the recording in every file of OUT, unique in the run and safe as a file name.
    file : str
        Path relative to the folder given, as it is on disk (shown escaped).
    sha256 : str
        Of the file's bytes; empty when it could not be read.
    mode : int or None
        The mode that the user says was excited.
    tracks, series, identification, comparison, kept_frames, simulated_footage :
        Results of the stages; a failure is a falsy value with its reason.
    """

    name: str
    file: str
    sha256: str
    mode: int | None
    tracks: MarkerTracks | FailedTracking | None = None
    series: DisplacementSeries | None = None
    identification: Identification | FailedIdentification | None = None
    comparison: DecayComparison | FailedComparison | None = None
    kept_frames: KeptFrames | NoKeptFrames | None = None
    simulated_footage: SimulatedFootage | NoSimulatedFootage | None = None

    @property
    def failure(self) -> str:
        """Why the recording gave no mode; empty when it gave one."""
        if isinstance(self.tracks, FailedTracking):
            return self.tracks.reason
        if isinstance(self.identification, FailedIdentification):
            return self.identification.reason
        if self.identification is not None and not self.identification.modes:
            return "; ".join(mode.reason for mode in self.identification.failed) or "no mode was found"
        return ""

    @property
    def target_failure(self) -> str:
        """Why the mode that the recording was made for is not among its modes; empty when it is."""
        if self.identification is None or isinstance(self.identification, FailedIdentification):
            return ""
        return next((mode.reason for mode in self.identification.failed if mode.target), "")


@dataclass(frozen=True)
class BeamResult:
    """The beam before and after updating.

    Attributes
    ----------
    standard, standard_modes :
        As configured, and its modes about the equilibrium under gravity.
    updated : Updating or None
        Matched to the measured modes; None when nothing was measured, with the reason in `note`.
    updated_modes : BeamModes or None
    rayleigh_alpha_1_s, rayleigh_beta_s : float
        Eq. 4 from the two lowest measured modes; NaN when fewer than two were measured.
    note : str
    """

    standard: BeamProperties
    standard_modes: BeamModes
    updated: Updating | None = None
    updated_modes: BeamModes | None = None
    rayleigh_alpha_1_s: float = float("nan")
    rayleigh_beta_s: float = float("nan")
    note: str = ""


@dataclass(frozen=True)
class RunResult:
    """Everything that one run found, and what it could not do and why.

    Attributes
    ----------
    folder : str
        Name of the folder given (its last component).
    recordings : tuple of RecordingResult
        In natural order of their files.
    beam : BeamResult or None
        None without a usable ``[beam]``.
    not_done : tuple of str
        What was left out and why, each a full sentence.
    resolved_config : str
        The configuration as resolved, in TOML.
    versions : tuple of (str, str)
        Program and libraries.
    command_line : str
    seed : int
    internal_errors : int
        Tasks that failed for a fault of the program.
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

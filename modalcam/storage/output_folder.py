"""The folder OUT: where each file of a run lies, its lock, and what the next stage needs to know."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from modalcam.config.schema import ExperimentConfig
from modalcam.config.toml import parse_config
from modalcam.errors import InputError
from modalcam.storage.atomic import write_text


@dataclass(frozen=True)
class Source:
    """One input of a run: name in OUT, path as given, hash, and the mode it was made for."""

    name: str
    file: str
    sha256: str
    mode: int | None


@dataclass(frozen=True)
class RunRecord:
    """What a run was asked to do, kept for the stages that start from its saved results."""

    folder: str
    sources: tuple[Source, ...]
    config: ExperimentConfig
    seed: int
    command_line: str
    notes: tuple[str, ...] = ()


class Workspace:
    """Paths in OUT."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.report = out / "report.html"
        self.paper = out / "paper.html"
        self.modes = out / "modes.csv"
        self.comparison = out / "comparison.csv"
        self.updating = out / "updating.csv"
        self.summary = out / "summary.json"
        self._state = out / "state"
        self._record = self._state / "run.json"

    def tracks(self, name: str) -> Path:
        """CSV of one recording's marker positions."""
        return self.out / "tracks" / f"{name}.csv"

    def posterior(self, name: str) -> Path:
        """NetCDF of one recording's posterior draws."""
        return self.out / "posterior" / f"{name}.nc"

    def universal(self, name: str) -> Path:
        """Universal file of one recording's series and mode shapes."""
        return self.out / "universal" / f"{name}.uff"

    def state(self, name: str, stage: str) -> Path:
        """Saved result of one stage of one recording (or of the beam, under a name no recording has)."""
        return self._state / f"{name}.{stage}.npz"

    def prepare(self, *, inputs: Path | None, force: bool) -> None:
        """Make OUT, or accept it when it is empty or an earlier run's.

        Raises
        ------
        InputError
            If OUT is a file, the inputs' own folder, or holds other things and `force` is not given.
        """
        if self.out.exists() and not self.out.is_dir():
            msg = f"{self.out}: expected a folder for the results, found a file; give another -o"
            raise InputError(msg)
        if inputs is not None and self.out.resolve() == inputs.resolve():
            msg = f"{self.out}: results are never written among the recordings; give another folder with -o"
            raise InputError(msg)
        try:
            foreign = self.out.exists() and any(self.out.iterdir()) and not self._state.is_dir()
            if foreign and not force:
                msg = f"{self.out}: holds files that are not results of modalcam; give another -o, or --force"
                raise InputError(msg)
            self._state.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            msg = f"{self.out}: cannot be written ({error.strerror}); give another -o"
            raise InputError(msg) from error

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold OUT for this process.

        Raises
        ------
        InputError
            If another run holds it.
        """
        lock = FileLock(self._state / "lock")
        try:
            lock.acquire(timeout=0)
        except Timeout:
            msg = f"{self.out}: another run is writing there; wait for it or give another -o"
            raise InputError(msg) from None
        try:
            yield
        finally:
            lock.release()

    def write_record(self, record: RunRecord) -> None:
        """Keep what the run was asked for the stages that follow."""
        data = {
            "folder": record.folder,
            "sources": [asdict(source) for source in record.sources],
            "config": record.config.model_dump(mode="json", exclude_none=True),
            "seed": record.seed,
            "command_line": record.command_line,
            "notes": list(record.notes),
        }
        write_text(self._record, json.dumps(data, indent=1) + "\n")

    def read_record(self) -> RunRecord:
        """What the run in OUT was asked.

        Raises
        ------
        InputError
            If OUT holds no run, or a damaged one.
        """
        try:
            data = json.loads(self._record.read_text("utf-8"))
            return RunRecord(
                folder=data["folder"],
                sources=tuple(Source(**source) for source in data["sources"]),
                config=parse_config(data["config"], where=str(self._record)),
                seed=data["seed"],
                command_line=data["command_line"],
                notes=tuple(data["notes"]),
            )
        except FileNotFoundError:
            msg = f"{self.out}: holds no results; make them with `modalcam run FOLDER -o {self.out}`"
            raise InputError(msg) from None
        except (OSError, ValueError, KeyError, TypeError) as error:
            msg = f"{self._record}: damaged ({error}); run again with --force"
            raise InputError(msg) from error

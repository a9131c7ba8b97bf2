"""The folder OUT: paths of a run's files, its lock, the record of what was run, and the files' hashes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePath, PureWindowsPath
from typing import Any

from filelock import FileLock, Timeout

from modalcam.common import InputError, OutputError, real, shown
from modalcam.config import ExperimentConfig, parse_config
from modalcam.pipeline.atomic import read_json, remove_partial, write_json
from modalcam.pipeline.provenance import file_sha256, recording_sha256


@dataclass(frozen=True)
class Source:
    """One input of a run: name in OUT, path as given, hash, mode that was excited, and reason of an unsaved failure."""

    name: str
    file: str
    sha256: str
    mode: int | None
    failure: str = ""


@dataclass(frozen=True)
class RunRecord:
    """What a run was asked to do and where its results are, kept in OUT for later commands.

    `notes` are sentences about the inputs, for instance files that were left out, `skipped` about steps that could not
    be done; `results` holds the key of each saved result, by name of the recording and of the stage's file. `key` is
    the hash of all that the run depends on, empty if a task failed, so that the next run tries it again.
    """

    folder: str
    sources: tuple[Source, ...]
    config: ExperimentConfig
    seed: int
    command_line: str
    notes: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    results: dict[str, dict[str, str]] = field(default_factory=dict)
    key: str = ""


class Workspace:
    """Paths in OUT."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.report = out / "report.html"
        self.paper = out / "paper.html"
        self.summary = out / "summary.json"
        self.config = out / "run.toml"
        self.log = out / "run.log"
        self._state = out / "state"
        self._record = self._state / "run.json"
        self.hashes = self._state / "inputs.json"
        self.written = self._state / "outputs.json"
        self.figures = self._state / "figures"
        self.studio_draft = self._state / "draft.json"

    def tracks(self, name: str) -> Path:
        """CSV of one recording's marker positions."""
        return self._within(self.out / "tracks", f"{name}.csv")

    def first_frame(self, name: str) -> Path:
        """Picture of the first frame of a recording without markers."""
        return self._within(self.out / "first_frame", f"{name}.png")

    def posterior(self, name: str) -> Path:
        """NetCDF of one recording's posterior draws."""
        return self._within(self.out / "posterior", f"{name}.nc")

    def universal(self, name: str) -> Path:
        """Universal file of one recording's series and mode shapes."""
        return self._within(self.out / "universal", f"{name}.uff")

    def response(self, name: str) -> Path:
        """CSV of the frequency response of one recording to its measured input."""
        return self._within(self.out / "response", f"{name}.csv")

    def state(self, name: str, stage: str) -> Path:
        """Saved result of one stage of one recording (or of the beam, under a name that no recording has)."""
        return self._within(self._state, f"{name}.{stage}.npz")

    def prepare(self, *, inputs: Path | None, force: bool, target: str | None = None) -> None:
        """Make OUT, or accept it if it is empty, holds an earlier run of `target` or, with `force`, anything.

        It is never a file or the folder of the recordings. Without a target any run is accepted.
        """
        if self.out.exists() and not self.out.is_dir():
            msg = f"{self.out}: expected a folder for the results, found a file; give another -o"
            raise InputError(msg)
        if inputs is not None and real(self.out) == real(inputs):
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
        with suppress(InputError):
            earlier = None if force or target is None else self.read_state()["folder"]
            if earlier not in (None, target):
                msg = (
                    f"{self.out}: holds the results of {shown(str(earlier))}, not of {shown(str(target))}; give "
                    "another -o, or --force to replace them"
                )
                raise OutputError(msg)

    def check_links(self) -> None:
        """OutputError for a link with which OUT would have files written or deleted elsewhere."""
        for place, folders, files in os.walk(self.out):
            saved = self._state in (Path(place), *Path(place).parents)
            for path in (Path(place, name) for name in (*folders, *(files if saved else ()))):
                if path.is_symlink():
                    msg = (
                        f"{shown(str(path))}: expected a folder or file of modalcam, found a link; remove it, or give "
                        "another -o"
                    )
                    raise OutputError(msg)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Lock OUT for this process, without what a killed one left; InputError if another process has locked it."""
        self.check_links()
        with ExitStack() as stack:
            try:
                stack.enter_context(FileLock(self._state / "lock", timeout=0))
            except Timeout:
                msg = f"{self.out}: another run is writing there; wait for it or give another -o"
                raise InputError(msg) from None
            except OSError as error:
                msg = f"{self.out}: cannot be written ({error.strerror}); give another -o"
                raise OutputError(msg) from error
            remove_partial(self.out)
            yield

    def write_record(self, record: RunRecord) -> None:
        """Save the record of a run."""
        data = asdict(replace(record, config=ExperimentConfig()))
        data["config"] = record.config.model_dump(mode="json", exclude_none=True)
        write_json(self._record, data)

    def read_record(self) -> RunRecord:
        """Record of the run in OUT; InputError if it holds no run, or a damaged one."""
        data = self.read_state()
        try:
            sources = tuple(Source(**source) for source in data["sources"])
            _check(str, *(text for s in sources for text in (s.name, s.file, s.sha256, s.failure)))
            _check(int, data["seed"], *(s.mode for s in sources if s.mode is not None))
            data["config"] = parse_config(data["config"], where=str(self._record))
            return RunRecord(**data | {"sources": sources})
        except (ValueError, KeyError, TypeError) as error:
            raise self._damaged(error) from error

    def read_state(self) -> dict[str, Any]:
        """Fields of the record, with the unparsed sources and configuration."""
        try:
            data = read_json(self._record)
            for name in ("notes", "skipped"):
                data[name] = tuple(data[name])
            data["versions"] = tuple((name, version) for name, version in data["versions"])
            record = RunRecord(**data)
            _check(str, record.folder, record.command_line, record.key, *record.notes, *record.skipped)
            _check(str, *(text for pair in record.versions for text in pair))
            _check(
                str, *(text for files in record.results.values() for pair in files.items() for text in pair)
            )
            return vars(record)
        except FileNotFoundError:
            msg = f"{self.out}: holds no results; make them with `modalcam run FOLDER -o {self.out}`"
            raise InputError(msg) from None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise self._damaged(error) from error

    def reopen(self) -> None:
        """Clear the key of the run in OUT, whose saved results are about to be replaced."""
        with suppress(InputError):
            data = self.read_state()
            if data["key"]:
                write_json(self._record, data | {"key": ""})

    @staticmethod
    def _within(folder: Path, name: str) -> Path:
        """A file of this folder: a name from a record in OUT never leads out of it."""
        if PurePath(name).name != name or PureWindowsPath(name).name != name:
            msg = f"{folder}: expected the name of a recording, found {shown(name)}; run again with --force"
            raise InputError(msg)
        return folder / name

    def _damaged(self, error: Exception) -> InputError:
        return InputError(f"{self._record}: damaged ({error}); run again with --force")


def _check(kind: type, *values: object) -> None:
    if not all(isinstance(value, kind) for value in values):
        msg = f"expected {'text' if kind is str else 'whole numbers'}"
        raise TypeError(msg)


def stays_below(name: str) -> bool:
    """Whether a relative path leads to no place outside its folder."""
    return ".." not in PurePath(name).parts and not PurePath(name).is_absolute()


class Outputs:
    """Record of the files that runs wrote into OUT: the key and the SHA-256 of each.

    With `force`, or if the record is missing or damaged, every file is written again. Names that lead out of OUT are
    ignored.
    """

    def __init__(self, workspace: Workspace, *, force: bool = False) -> None:
        self._workspace = workspace
        self._written: dict[str, list[str]] = {}
        with suppress(OSError, ValueError, TypeError):
            for name, (key, sha256) in read_json(workspace.written).items():
                if stays_below(name):
                    self._written[name] = ["" if force else key, sha256]

    def write(self, path: Path, key: str, write: Callable[[Path], object]) -> bool:
        """Call ``write(path)`` unless the file is intact and has the same key; returns whether it was kept.

        The key is the hash of all that the file depends on; `write` writes it whole or not at all.
        """
        name = path.relative_to(self._workspace.out).as_posix()
        if self._is_intact(name) and self._written[name][0] == key:
            return True
        self._written.pop(name, None)
        write(path)
        self._written[name] = [key, file_sha256(path)]
        return False

    def are_intact(self) -> bool:
        """Whether every file of the record is unchanged in OUT."""
        return bool(self._written) and all(self._is_intact(name) for name in self._written)

    def intact(self) -> dict[str, bool]:
        """Whether each file of the record, by its name in OUT, is unchanged."""
        return {name: self._is_intact(name) for name in self._written}

    def finish(self, keep: Iterable[Path]) -> None:
        """Delete the files of earlier runs but those in `keep`, unless somebody has changed them; save the record."""
        names = {path.relative_to(self._workspace.out).as_posix() for path in keep}
        for name in self._written.keys() - names:
            if self._is_intact(name):
                (self._workspace.out / name).unlink()
        entries = {name: self._written[name] for name in sorted(names)}
        write_json(self._workspace.written, entries)

    def _is_intact(self, name: str) -> bool:
        path = self._workspace.out / name
        try:
            # a pipe in its place would block
            return path.is_file() and file_sha256(path) == self._written[name][1]
        except (OSError, LookupError):
            return False


def changed_files(out: Path) -> tuple[int, list[str]]:
    """Number of files that the run in OUT recorded, and a sentence for each that is missing or has changed.

    InputError if OUT holds no run.
    """
    workspace = Workspace(out)
    workspace.read_state()
    files = Outputs(workspace).intact()
    if not files:
        where = shown(str(out))
        msg = f"{where}: holds no record of its files; write them again with `modalcam report {where}`"
        raise InputError(msg)
    changed = [name for name, unchanged in files.items() if not unchanged]
    return len(files), [_sentence(out / name, name) for name in changed]


def changed_recordings(out: Path, folder: Path) -> tuple[int, list[str]]:
    """As `changed_files`, of the recordings of the run that are in `folder`."""
    sources = [source for source in Workspace(out).read_record().sources if source.sha256]
    changed = []
    for source in sources:
        path = folder / source.file
        try:
            # A name that OUT gives may lead to any place.
            readable = stays_below(source.file) and (path.is_file() or path.is_dir())
            unchanged = readable and recording_sha256(path) == source.sha256
        except OSError:
            unchanged = False
        if not unchanged:
            changed.append(_sentence(path, source.file))
    return len(sources), changed


def _sentence(path: Path, name: str) -> str:
    return f"{shown(name)}: {'changed since the run' if path.exists() else 'missing'}"

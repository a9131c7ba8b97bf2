"""Expected errors, whose text states what to do, and the exit codes of the program."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """Exit codes of the program."""

    OK = 0
    INTERNAL = 1
    USAGE = 2
    NO_INPUT = 3
    PARTIAL = 4
    INTERRUPTED = 130
    CLOSED_OUTPUT = 141


class ModalcamError(Exception):
    """An expected error: its text states what was expected, what was found, where, and what to do."""

    exit_code = ExitCode.USAGE


class ConfigError(ModalcamError):
    """A configuration that cannot be used."""


class InputError(ModalcamError):
    """Input that cannot be used at all."""


class OutputError(ModalcamError):
    """Results that cannot be written."""


class NoInputError(ModalcamError):
    """No recording was found."""

    exit_code = ExitCode.NO_INPUT


class TrackingError(ModalcamError):
    """A recording that could not be tracked; the text gives the reason and a remedy."""


class IdentificationError(ModalcamError):
    """A series without an identifiable mode; the text gives the reason and a remedy."""

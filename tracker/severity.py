"""Severity of a quality flag: what it means for the result."""

from __future__ import annotations

from enum import Enum


class Severity(Enum):
    """In order; the value states the meaning in report and documentation."""

    WRONG = "The value may be wrong by more than its interval."
    INTERVAL = "The interval is right, and wider for this reason; or part of the record is missing."
    INFORMATION = "The value and its interval account for it."

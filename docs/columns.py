"""Write docs/columns.md from the registry of the tables' columns: `python docs/columns.py`."""

from __future__ import annotations

from pathlib import Path

from modalcam.tables import markdown

Path(__file__).with_suffix(".md").write_text(markdown(), encoding="utf-8")

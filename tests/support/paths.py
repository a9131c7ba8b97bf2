"""Folders that tests read from."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "sample_videos"
# third-party recordings next to a development checkout; without them, the tests that need them are skipped
REALDATA = ROOT.parent / "shared" / "realdata"

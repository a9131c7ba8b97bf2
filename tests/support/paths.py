"""Folders that tests read from."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "sample_videos"
# recordings by others, beside a development checkout; tests that need them are skipped without them
REALDATA = ROOT.parent / "shared" / "realdata"

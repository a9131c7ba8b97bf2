"""``python -m modalcam``."""

from modalcam.cli import main

main()

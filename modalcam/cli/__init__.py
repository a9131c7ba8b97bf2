"""Command line of modalcam. Heavy imports stay inside the commands, so that --help is shown at once."""

from modalcam.cli.app import app, main

__all__ = ["app", "main"]

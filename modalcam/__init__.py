"""From a folder of high-speed recordings of a thin beam to one report: CLI, configuration, pipeline."""

__version__ = "0.1.0"

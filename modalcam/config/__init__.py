"""The configuration, `experiment.toml`."""

"""The same beam in several runs: differences and scatter of its modes."""

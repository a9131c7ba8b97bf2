"""The paper's beam and tables."""

"""An experiment predicted before it is filmed: intervals of frequency and damping per mode, and what limits each."""

"""Which modes are in a decay, and what their poles are."""

"""Tasks in other processes, here or on a cluster."""

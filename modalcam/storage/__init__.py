"""The folder of the results: its files, saved results, and the hashes that decide whether they are valid."""

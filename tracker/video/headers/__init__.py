"""Headers that cameras write beside or into their recordings."""

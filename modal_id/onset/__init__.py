"""Where the free decay begins."""

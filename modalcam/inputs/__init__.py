"""What a folder holds: recordings and displacement series."""

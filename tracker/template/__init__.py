"""The noise-free picture of a marker, its blur, and the noise of the pixels."""

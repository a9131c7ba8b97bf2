"""Numbers, shapes, flags and checks of identified modes."""

"""Numbers, shapes and checks of identified modes."""

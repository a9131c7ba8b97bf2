"""The camera between the beam and its picture: lens, view, shutter, exposure."""

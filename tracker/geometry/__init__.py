"""From pixels and time stamps to millimetres and seconds: lens, plane, scale, exposure, time axis."""

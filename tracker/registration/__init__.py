"""Registration: the sub-pixel position of a marker by fitting a noise-free template to the pixels."""

"""The bare beam seen edge-on: its centreline, surface and image."""

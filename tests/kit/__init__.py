"""What tests are made of: one maker each of beams, series, films, tracks, identifications, runs and attacks."""

"""The beam of most tests, as tables of a configuration; `sim.paper_beam` and `sim.sample_beam` are its models."""

BEAM = {
    "length_mm": 500.0,
    "width_mm": 5.0,
    "thickness_mm": 0.5,
    "density_kg_m3": 8000.0,
    "elastic_modulus_mpa": 210000.0,
}


def experiment(before="", after="", **changes):
    """Text of an experiment.toml with this beam, `changes` to it, and what stands before and after it."""
    beam = "".join(f"{key} = {value}\n" for key, value in (BEAM | changes).items())
    return f"{before}[beam]\n{beam}{after}"

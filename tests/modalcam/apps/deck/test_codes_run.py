"""OpenSees and CalculiX with their decks against linear theory of the same beam. Exudyn: tests/benchmarks."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from kit.decks import paper_damping, read_by_the_code

from modalcam.apps.deck import deck
from sim import MEASURED_DAMPING_RATIO, paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.dynamics import state_with_coordinates

ELEMENTS, RATIOS = 10, np.array(MEASURED_DAMPING_RATIO)


def opensees_decay(ops, beam, speed, step_s, steps, every):
    """Deflection of the tip from a straight beam in motion; `speed`, shape (nodes - 1, 2), of deflection and slope."""
    p, h = beam.properties, beam.element_length_m
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for k in range(ELEMENTS + 1):
        ops.node(k + 1, k * h, 0.0)
    ops.fix(1, 1, 1, 1)
    ops.geomTransf("Linear", 1)
    for k in range(ELEMENTS):
        section = (p.area_m2[0], p.elastic_modulus_pa, p.second_moment_m4[0])
        mass = p.density_kg_m3 * p.area_m2[0]
        ops.element("elasticBeamColumn", k + 1, k + 1, k + 2, *section, 1, "-mass", mass, "-cMass")
    for line in read_by_the_code(deck(paper_damping(), "opensees"), "opensees"):
        command, *numbers = line.split()
        getattr(ops, command)(*(int(x) if x.isdigit() else float(x) for x in numbers))
    for k, (deflection, slope) in enumerate(speed.tolist()):
        ops.setNodeVel(k + 2, 2, deflection, "-commit")
        ops.setNodeVel(k + 2, 3, slope, "-commit")
    for command, *values in (
        ("constraints", "Plain"),
        ("numberer", "Plain"),
        ("system", "FullGeneral"),
        ("test", "NormDispIncr", 1e-14, 20),
        ("algorithm", "Newton"),
        ("integrator", "Newmark", 0.5, 0.25),
        ("analysis", "Transient"),
    ):
        getattr(ops, command)(*values)
    found = [0.0]
    for _ in range(steps // every):
        assert ops.analyze(every, step_s) == 0
        found.append(ops.nodeDisp(ELEMENTS + 1, 2))
    return np.array(found)


def test_the_decay_of_opensees_with_the_deck_is_that_of_theory():
    ops = pytest.importorskip("openseespy.opensees", reason="pip install openseespy")
    beam = AncfBeam(paper_beam(orientation="none", elements=ELEMENTS), 5)
    modes = beam_modes(beam, 5)
    omega = modes.omega_rad_s
    amplitude_m = np.array([1e-3, 5e-4, 3e-4, 2e-4, 1e-4])
    rate = amplitude_m * omega / modes.transverse_at(np.array([0.5]))[0]
    state = state_with_coordinates(beam, modes, np.zeros(5), rate)
    step_s, every, count = 5e-5, 20, 200
    # Of each free node deflection and slope, among four coordinates.
    speed = state.v.reshape(-1, 4)[:, [1, 3]]
    theirs = opensees_decay(ops, beam, speed, step_s, every * count, every)
    t = step_s * every * np.arange(count + 1)
    damped = omega * np.sqrt(1.0 - RATIOS**2)
    each = (amplitude_m * omega / damped) * np.exp(-np.outer(t, RATIOS * omega)) * np.sin(np.outer(t, damped))
    # Newmark's average acceleration delays mode n by (omega h)^2 omega t / 12 radians.
    allowed = amplitude_m @ ((omega * step_s) ** 2 * omega * t[-1] / 12.0)
    theory = each.sum(axis=1)
    error = np.abs(theirs - theory).max()
    assert error < 1.2 * allowed, f"{error:.1e} m from theory, of which its steps explain {allowed:.1e}"
    undamped = (each * np.exp(np.outer(t, RATIOS * omega))).sum(axis=1)
    assert error < 0.05 * np.abs(theory - undamped).max(), "damping would hardly matter in this decay"


CALCULIX = """*NODE, NSET=ALL
{nodes}
*ELEMENT, TYPE=B32R, ELSET=BEAM
{elements}
*NSET, NSET=TIP
{last}
*MATERIAL, NAME=STEEL
*ELASTIC
{modulus!r}, 0.
*DENSITY
{density!r}
*BEAM SECTION, SECTION=RECT, MATERIAL=STEEL, ELSET=BEAM
5e-4, 5e-3
0, 1, 0
*BOUNDARY
1, 1, 6
ALL, 3, 3
*STEP
*FREQUENCY, STORAGE=YES
6
*CLOAD
{last}, 2, 0.
*END STEP
*STEP
*STEADY STATE DYNAMICS
1., 120., 20, 3.
{deck}*CLOAD
{last}, 2, 1e-3
*NODE PRINT, NSET=TIP
U
*END STEP
"""


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed: apt install calculix-ccx")
def test_the_response_of_calculix_with_the_deck_is_that_of_theory(tmp_path):
    count, p = 40, paper_beam(orientation="none", elements=40)
    (tmp_path / "b.inp").write_text(
        CALCULIX.format(
            nodes="\n".join(f"{k + 1}, {k * 0.5 / (2 * count)!r}, 0, 0" for k in range(2 * count + 1)),
            elements="\n".join(f"{k + 1}, {2 * k + 1}, {2 * k + 2}, {2 * k + 3}" for k in range(count)),
            last=2 * count + 1,
            modulus=p.elastic_modulus_pa,
            density=p.density_kg_m3,
            deck=deck(paper_damping(), "calculix"),
        )
    )
    given = {"OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin"}
    subprocess.run([shutil.which("ccx"), "-i", "b"], cwd=tmp_path, env=given, check=True, capture_output=True)
    text = (tmp_path / "b.dat").read_text()
    head = text.partition("P A R T I C I P A T I O N   F A C T O R S   F O R")[0]
    rows = [line.split() for line in head.splitlines()]
    hz = np.array([float(row[3]) for row in rows if len(row) == 5 and row[0].isdigit()])[:6]
    found = re.findall(rf"set TIP and time\s+(\S+)\s+{2 * count + 1}\s+\S+\s+(\S+)", text)
    pairs = np.array(found, dtype=float)
    at_hz, theirs = pairs[::2, 0], pairs[::2, 1] + 1j * pairs[1::2, 1]
    tip = beam_modes(AncfBeam(p, 5), 8).transverse_at(np.array([0.5]))[0, :6]
    omega, own = 2.0 * np.pi * at_hz[:, None], 2.0 * np.pi * hz
    theory = (1e-3 * tip**2 / (own**2 - omega**2 + 2j * np.append(RATIOS, 0.0) * own * omega)).sum(axis=1)
    peaks = [int(np.argmin(np.abs(at_hz - one))) for one in hz[:5]]
    error = np.abs(theirs / theory - 1.0)[peaks]
    assert np.all(error < 2e-4), (
        f"at the resonances {error}: the mesh, and deflection by shear, (n pi h / l)^2 / 4 = 6e-5, change the "
        "shapes by 1e-4; a ratio off by 1 % would be 1e-2"
    )

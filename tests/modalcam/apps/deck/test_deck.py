"""Decks read back by the syntax that each code's manual states; the sources are those of docs/decks.md."""

import re

import numpy as np
import pytest
import typer
from kit.decks import paper_damping, rayleigh_lines, read_by_the_code

from modalcam.apps.deck import CODES, DampedMode, Damping, damping_of, deck, register_code
from modalcam.cli import app
from modalcam.common import InputError
from modalcam.pipeline import load_run
from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ

#: Values are written with six significant digits; the small fields of Nastran hold four or more.
ROUNDED, SMALL_FIELD = 1e-5, 1e-3


def numbers(text):
    return [float(word) for word in text.split(",") if word.strip()]


def nastran_real(text):
    """A real number whose exponent may lack its letter (MSC Nastran, Quick Reference Guide, input of numbers)."""
    return float(re.sub(r"(?<=[0-9.])([+-]\d+)$", r"e\1", text.replace("E", "e")))


def table_of_frequencies(name, lines):
    """Frequencies in Hz and ratios of a table over frequency."""
    if name == "abaqus":
        # Abaqus Keywords Reference, *MODAL DAMPING, data lines of DEFINITION=FREQUENCY RANGE
        head, *rows = lines
        assert head == ("*MODAL DAMPING, VISCOUS=FRACTION OF CRITICAL DAMPING, DEFINITION=FREQUENCY RANGE")
        return np.array([numbers(row) for row in rows])
    # MSC Nastran, TABDMP1: ID, TYPE; then pairs f, g, eight fields a line, ended by ENDT
    head, *rows = lines
    assert head == "TABDMP1,10,CRIT"
    assert all(row.startswith("+,") for row in rows)
    words = [word for row in rows for word in row.split(",")[1:]]
    assert all(len(word) <= 8 for word in words), f"a small field holds eight characters: {words}"
    assert max(len(row.split(",")) for row in rows) <= 9, "eight fields follow the continuation"
    assert words.pop() == "ENDT"
    return np.array([nastran_real(word) for word in words]).reshape(-1, 2)


def ratios_by_number(name, lines):
    """Damping ratios of modes 1, 2, ... as the manual of the code counts them."""
    text = "\n".join(lines)
    if name == "ansys":
        # MDAMP, STLOC, V1, ..., V6: ratios of the modes from STLOC on
        found = [line.removeprefix("MDAMP,").split(",") for line in lines]
        assert [int(one[0]) for one in found] == list(range(1, 6 * len(found), 6))
        return [float(word) for one in found for word in one[1:]]
    if name == "calculix":
        # CalculiX User's Manual, *MODAL DAMPING: lowest mode, highest mode, viscous damping factor
        head, *rows = lines
        assert head == "*MODAL DAMPING"
        for n, row in enumerate(rows, 1):
            assert numbers(row)[:2] == [n, n]
        return [numbers(row)[2] for row in rows]
    if name == "mbdyn":
        # MBDyn Input Manual, modal joint: diag damping, NUM, (MODE, FACTOR), ...,
        words = text.removeprefix("diag damping,").removesuffix(",").split(",")
        count, pairs = int(words[0]), np.array(words[1:], dtype=float).reshape(-1, 2)
        assert pairs[:, 0].tolist() == list(range(1, count + 1))
        return pairs[:, 1].tolist()
    if name == "opensees":
        # eigen numEigenvalues; modalDamping factor1 ... factorN
        found = [float(word) for word in lines[1].removeprefix("modalDamping ").split()]
        assert lines[0] == f"eigen {len(found)}"
        return found
    patterns = {
        # ChModalDampingFactorRmm(ChVectorDynamic<>), api.projectchrono.org
        "chrono": r"zeta << ([^;]+);",
        # DYNA_VIBRA, AMOR_MODAL, AMOR_REDUIT: list of reals
        "code_aster": r"AMOR_REDUIT=\(([^)]+)\)",
        "exudyn": r"ZETA = np\.array\(\[([^]]+)\]\)",
    }
    return numbers(re.search(patterns[name], text)[1])


@pytest.mark.parametrize("name", ["abaqus", "nastran", "optistruct"])
def test_a_table_over_frequency_holds_what_was_measured(name):
    table = table_of_frequencies(name, read_by_the_code(deck(paper_damping(), name), name))
    inside = table if name == "abaqus" else table[1:-1]
    expected = np.column_stack([MEASURED_FREQUENCY_HZ, MEASURED_DAMPING_RATIO])
    np.testing.assert_allclose(inside, expected, rtol=ROUNDED if name == "abaqus" else SMALL_FIELD)
    if name != "abaqus":
        # Outside, TABDMP1 is extrapolated through two points: they must have the same ratio.
        assert table[0, 1] == table[1, 1]
        assert table[-1, 1] == table[-2, 1]


@pytest.mark.parametrize("name", sorted(set(CODES) - {"abaqus", "nastran", "optistruct"}))
def test_ratios_by_number_are_the_measured_ones(name):
    found = ratios_by_number(name, read_by_the_code(deck(paper_damping(), name), name))
    np.testing.assert_allclose(found, MEASURED_DAMPING_RATIO, rtol=ROUNDED)


def coefficients(name, lines):
    """Alpha (1/s, on the mass) and beta (s, on the stiffness) as the manual of the code names them."""
    text = "\n".join(lines)
    if name in ("nastran", "optistruct"):
        # ALPHA1 scales the mass, ALPHA2 the stiffness
        return [nastran_real(line.split(",")[2]) for line in lines]
    patterns = {
        "abaqus": r"ALPHA=(?P<a>[^,\s]+), BETA=(?P<b>\S+)",
        "calculix": r"ALPHA=(?P<a>[^,\s]+), BETA=(?P<b>\S+)",
        "ansys": r"ALPHAD,(?P<a>\S+)\s+BETAD,(?P<b>\S+)",
        "chrono": r"ChModalDampingRayleigh damping\((?P<a>[^,]+), (?P<b>[^)]+)\)",
        # reversed: AMOR_ALPHA is on the stiffness (documentation of DEFI_MATERIAU, U4.43.01)
        "code_aster": r"AMOR_ALPHA=(?P<b>[^,]+), AMOR_BETA=(?P<a>[^,]+)",
        "exudyn": r"ALPHA_1_S, BETA_S = (?P<a>[^,]+), (?P<b>\S+)",
        "mbdyn": r"rayleigh damping, (?P<a>[^,]+), (?P<b>[^,]+)",
        "opensees": r"rayleigh (?P<a>\S+) (?P<b>\S+) 0.0 0.0",
    }
    found = re.search(patterns[name], text)
    return [float(found["a"]), float(found["b"])]


@pytest.mark.parametrize("name", sorted(CODES))
def test_rayleigh_coefficients_are_the_least_squares_fit(name):
    omega = 2.0 * np.pi * np.array(MEASURED_FREQUENCY_HZ)
    design = np.column_stack([0.5 / omega, 0.5 * omega])
    # With both coefficients of this set positive, non-negative least squares is least squares.
    expected = np.linalg.lstsq(design, np.array(MEASURED_DAMPING_RATIO), rcond=None)[0]
    found = coefficients(name, rayleigh_lines(deck(paper_damping(), name), name))
    if expected.min() > 0.0:
        np.testing.assert_allclose(found, expected, rtol=SMALL_FIELD)
    else:
        assert min(found) == 0.0, "a negative coefficient would add energy"


@pytest.mark.parametrize("name", sorted(CODES))
def test_every_line_is_a_comment_or_of_the_code_and_states_the_interval(name):
    hostile = paper_damping()
    hostile = Damping(hostile.modes, ("a\nb */ *STEP: mode 9",), ("run of C:\\x",))
    text = deck(hostile, name)
    lines = text.splitlines()
    assert all(len(line) <= 80 or not line.startswith(CODES[name].comment) for line in lines)
    assert read_by_the_code(text, name) == read_by_the_code(deck(paper_damping(), name), name)
    joined = " ".join(line.removeprefix(CODES[name].comment).strip() for line in lines)
    assert "90 % interval" in joined


def test_a_mode_that_was_not_measured_is_interpolated_where_modes_are_counted_and_said():
    text = deck(paper_damping((1, 2, 4, 5, 6)), "ansys")
    found = ratios_by_number("ansys", read_by_the_code(text, "ansys"))
    zeta = MEASURED_DAMPING_RATIO
    assert found[2] == pytest.approx(0.5 * (zeta[1] + zeta[2]), rel=ROUNDED)
    assert "Not measured: mode 3" in text


def test_one_mode_has_no_rayleigh_damping():
    one = Damping((DampedMode(1, 2.0, 0.01, 0.009, 0.011),))
    assert "Rayleigh damping needs two measured modes" in deck(one, "abaqus")


def test_a_run_gives_the_modes_of_its_table(samples_run):
    damping = damping_of(load_run(samples_run))
    assert [mode.number for mode in damping.modes] == [1, 2, 3, 4, 5]
    assert all(mode.low < mode.damping_ratio < mode.high for mode in damping.modes)
    assert any("SHA-256" in line for line in damping.provenance)


def test_the_help_of_the_command_names_every_code():
    option = next(p for p in typer.main.get_command(app).commands["deck"].params if p.name == "code")
    assert re.findall(r"[a-z_]{4,}", option.help.replace(" or ", ", ")) == list(CODES)


def test_an_unknown_code_and_a_name_given_twice_are_refused():
    with pytest.raises(InputError, match="expected one of abaqus"):
        deck(paper_damping(), "nasty")
    with pytest.raises(ValueError, match="registered already"):
        register_code(CODES["abaqus"].__class__("abaqus", "x", "#", (), list, list))

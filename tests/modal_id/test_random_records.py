"""Records of random decays and disturbances are answered right, widely, or not at all."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from kit.identified import quick

from benchmarks.random_records import random_record

# An answer is wrong beyond this number of stated standard deviations and beyond this share of the truth.
MOST_SD = 4.0
LEAST_SHARE = 0.01
# Of the records whose longest undisturbed decay determines frequency and damping ratio to 1 %.
MOST_REFUSED = 0.1


def answer(seed):
    record = random_record(seed)
    return record, quick(record.series)


def wrong_answers(record, found):
    """Sentences on all frequencies and damping ratios of `found` that contradict the truth."""
    wrong = []
    for mode in found.modes if found else ():
        truth = int(np.argmin(np.abs(np.log(np.array(record.frequency_hz) / mode.frequency_hz))))
        pairs = [
            ("Hz", mode.frequency_hz, mode.frequency_sd_hz, record.frequency_hz[truth]),
            ("damping ratio", mode.damping_ratio, mode.damping_ratio_sd, record.damping_ratio[truth]),
        ]
        for what, value, sd, true in pairs:
            if abs(value - true) > max(MOST_SD * sd, LEAST_SHARE * true):
                wrong.append(f"{what} {value:.6g} (sd {sd:.2g}) for {true:.6g}, {mode.flags}")
                break
    return wrong


def is_answered(record, found):
    """Whether the strongest mode has a frequency and a damping ratio."""
    frequency = record.frequency_hz[0]
    return any(
        np.isfinite(m.damping_ratio) and abs(m.frequency_hz / frequency - 1.0) < 0.05
        for m in (found.modes if found else ())
    )


@settings(max_examples=1, derandomize=True, deadline=None)
@given(st.integers(0, 499))
# Rest before a release, and a step after a stop by hand: close modes once imitated each.
@example(143)
@example(460)
# A weak mode beside a strong one: its density once had a second, false maximum where its series does not hold.
@example(112)
def test_a_random_record_is_not_answered_wrongly(seed):
    record, found = answer(seed)
    assert not wrong_answers(record, found), record


# Motion in a tenth of the record before a larger click; two plucks after a rest, over in few cycles each; a mode that
# only one of four decays shows; one whose oscillation a hand goes on with; a change whose limits rounding errors moved
# without end; a second decay whose mode with most energy is not the largest; a fit that grows without limit.
@pytest.mark.parametrize("seed", [12495, 12524, 11332, 11841, 13408, 13893, 14915])
def test_a_mode_that_is_plain_to_see_is_found(seed):
    record, found = answer(seed)
    assert is_answered(record, found), record
    assert not wrong_answers(record, found), record


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_random_records_are_not_answered_wrongly_and_rarely_refused():
    wrong, refused, informative = {}, [], 0
    for seed in range(500):
        record, found = answer(seed)
        if mistakes := wrong_answers(record, found):
            wrong[seed] = mistakes
        if record.is_informative:
            informative += 1
            refused += [] if is_answered(record, found) else [seed]
    assert not wrong
    assert informative > 200, "the records are too poor for a statement on refusals"
    assert len(refused) < MOST_REFUSED * informative, f"refused {refused} of {informative}"

"""Every sentence on a record that a user reads: why there is no result, notes, flags of a mode, checks of the residual.

A member is the code of a sentence, its value the words with places for values. The rest of the package decides and
passes values: numbers in the units that the words state, names of channels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from tracker import Failure, Severity


@dataclass(frozen=True)
class Refusal(Failure):
    """Why there is no result: falsy, a sentence, and the `codes`, names of `Reason`, of all that it states.

    `values` are what was put into the places of the first one's sentence.
    """

    codes: tuple[str, ...] = ()
    values: Mapping[str, float | str] = field(default_factory=dict, hash=False)

    def at(self, where: str) -> Refusal:
        """The same of a series."""
        return replace(self, where=where)

    @classmethod
    def joined(cls, several: Iterable[Refusal]) -> Refusal:
        """One or more in one sentence, the same words once."""
        each = list({one.reason: one for one in several}.values())
        codes = tuple(dict.fromkeys(code for one in each for code in one.codes))
        return cls("; ".join(one.reason for one in each), "", "", codes, each[0].values)


class Reason(Enum):
    """Why there is no result; called with the values of its sentence, the refusal."""

    # samples
    FEW_SAMPLES = "the series has {found} samples, but at least {least} are needed; record longer or at a higher frame rate"
    NO_CHANNEL = "no channel has a usable signal: {notes} Check the sensor, the markers or the columns."
    FEW_AT_ONE_RATE = "only {found} of the samples follow each other without a pause and at one rate, but at least {least} are needed. {notes}"
    CLIPPED = "the signal is clipped until the end of the record: too many samples share its largest or smallest value; reduce the amplitude or use a larger range; draw the markers of a synthetic film at fractions of a px, with gray edges"
    FEW_DISTINCT = "only {found} of {count} samples differ from the one before, but at least {least} are needed: frames are frozen or duplicated; check the camera or the file"
    FEW_INSIDE = "only {found} samples lie within {given}, but at least {least} are needed: the record runs from {start_s:.4g} s to {end_s:.4g} s"
    # parts of the record
    TWO_EXCITATIONS = 'the input was measured, and excitation is "ambient", for forces that are not measured: give one of the two; output_only ignores the input'
    NO_INPUT = "a lag of the input is asked for, but no input was measured: name it, or omit input_lag_ms"
    SHORT_PIECES = "free decays do not explain the motion as a whole, and its pieces between changes have too few cycles; set onset_s and end_s to one free decay"
    STEADY = "The motion does not decay: it is driven, or decays too slowly for this record."
    NO_DECAY = "No free decay was found"
    DRIVEN_THROUGHOUT = "The motion at {hz:.4g} Hz is steady from {start_s:.4g} s to {end_s:.4g} s: it is driven, and the record contains no free decay. Continue recording after the shaking stops"
    FEW_AFTER_ONSET = "only {found} samples follow the start of the free decay at {onset_s:.4g} s until {end_s:.4g} s; record longer after the stop, or set onset_s and end_s"
    NO_VIBRATION = "no vibration exceeds noise and drift: {motion}; check that the object moves, what was tracked, and that it oscillates: damping ratios above {most_zeta:g} are not identified"
    NO_STEADY_FREQUENCY = "no vibration with a steady frequency was found: {motion}. The motion may be drift, handling, an uneven drive, or several releases in succession; set onset_s and end_s to one free decay. It may also be a return to rest without oscillation: damping ratios above {most_zeta:g} are not identified"
    NOT_FREE_DECAYS = "the motion from {start_s:.4g} s to {end_s:.4g} s is not a sum of free decays: {percent:.2g} % of its power is left, most of it about {most_s:.4g} s; set onset_s and end_s to a free decay"
    # modes
    REJECTED = "it is no mode of the beam according to reject_hz; it was fitted beside the modes"
    NO_MODE = "it is no mode according to reject_hz"
    ALL_REJECTED = "reject_hz names every mode that was found; remove one from it"
    DRIVEN = "the motion at {hz:.4g} Hz does not decay: it is driven, or decays too slowly for this record; record the free decay after the drive stops"
    FORCED = "the motion at {hz:.4g} Hz does not decay (damping ratio {zeta:.2g}): it is a forced vibration, a hum, or noise; record the free decay after the stop"
    MAY_BE_DRIFT = "the record does not determine the motion near {hz:.3g} Hz (standard deviation {sd_hz:.2g} Hz, that of the damping ratio {zeta_sd_percent:.2g} %): it may be a drift instead of a vibration; film a free decay of at least ten cycles"
    HARDLY_DETERMINED = "this record hardly determines frequency and damping near {hz:.4g} Hz; a longer record or less noise is needed"
    NOT_SAMPLED = "near {hz:.4g} Hz {error}"
    NO_STEPS = (
        "the sampler could not propose steps ({error}); the record hardly determines this mode's parameters"
    )
    ENSEMBLES_DISAGREE = "the independent ensembles disagree (R-hat {r_hat:.2f}, at most {most} is allowed); a longer record or less noise is needed"
    NOT_FINITE = "the likelihood is not finite near the fitted mode; check the data"
    NONE_ACCEPTED = "no proposal was accepted; the record hardly determines this mode's parameters"
    NAMED_IS_NOISE = "the record does not determine a mode at {hz:.4g} Hz: what it shows there is no more than noise shows somewhere in a spectrum; record longer, with more motion in that mode or less noise"
    NAMED_IS_CLOSE = "{hz:.4g} Hz is too close to the mode at {mode_hz:.4g} Hz to be added: what that mode leaves there is its misfit, and two modes so close are separated without being named where the record resolves them"
    NAMED_ABOVE_NYQUIST = "{hz:.4g} Hz is not below half the sampling rate, {nyquist_hz:.4g} Hz"
    NAMED_IS_DRIFT = (
        "{hz:.4g} Hz is below {lowest_hz:.4g} Hz: motion that slow is fitted as drift of the positions"
    )
    SIDE_BAND = "it is a side band of the strongest mode, caused by frames that are not evenly spaced in time"
    TONE = "it is not a mode of its own but a distortion of a stronger motion, caused by nonlinearity or by measurement errors: its frequency is that of {terms}, and its decay rate agrees, too"
    WITHIN_ERRORS = "it is not listed as a mode: its amplitude, {amplitude:.2g} {unit}, is below {limit:.2g} {unit}, twice the standard deviation of position errors that repeat with the larger motion"
    NAMED_NEED_NOT_DECAY = "it is not listed as a mode: the record does not determine whether it decays (damping ratio {zeta_percent:.2g} % with a standard deviation of {sd_percent:.2g} %); record longer or with more motion in that mode"
    NOT_ESTABLISHED = "it is not listed as a mode: it hardly exceeds the noise, subspace identification does not confirm it, and it need not decay (damping ratio {zeta_percent:.2g} % with a standard deviation of {sd_percent:.2g} %)"
    # the target
    NUMBER_NOT_FOUND = "{fitting}mode {number} is expected near {expected_hz:.4g} Hz, but {seen}; {unit}check the recorded frame rate, the properties of the beam and the mode given for the recording"
    BEYOND_THEORY = (
        "mode {number} is requested, but theory provides only modes 1 to {count}; give a lower number"
    )
    NOT_WITHIN = "no mode was found within 10 % of {hz:.4g} Hz; the modes found are at {seen} Hz. {cause}"
    UNKNOWN_LENGTH = "the free length of the beam, or the places of the stations along it, are unknown"
    UNKNOWN_ENDS = "the stations reach from {first_percent:.0f} to {last_percent:.0f} % of the free length: what the beam does at an end that they do not show is unknown"
    FEW_STATIONS = "{found} stations are too few for a shape of mode {number}: {least} are needed"
    # ambient excitation
    UNEVEN = (
        "ambient identification needs an even sampling rate: times differ from an even grid by up to {off:.2g} of a step, and at most {most:g} is allowed",
        "record at a constant frame rate, or identify a free decay, which may have uneven times",
    )
    MISSING = (
        "ambient identification fills single missing samples: up to {most_percent:g} % of a channel and {most} in a row; {percent:.2g} % of a channel are missing, and {longest} in a row ({longest_s:.2g} s)",
        "cut the record with onset_s and end_s to a part without long gaps, or leave the channel out",
    )
    STROKE = (
        "the motion at {hz:.4g} Hz is not stationary: {percent:.2g} % of its power lie in {loud_percent:.2g} % of the record, most of it from {from_s:.4g} s on, as after a stroke. An ambient record holds motion under a steady random force",
        "identify the decay with excitation = 'free', or cut it out with onset_s and end_s",
    )
    DECAYS = (
        "the motion at {hz:.4g} Hz decays: the first half of the record has {ratio:.3g} times the power of the second. An ambient record holds motion under a steady random force",
        "identify the decay with excitation = 'free', or cut it out with onset_s and end_s",
    )
    LINE = "the peak at {hz:.4g} Hz is no wider than the record resolves: a motion of constant amplitude, such as a machine or hum, rather than a mode; record longer if it is one"
    SHORT_FOR_DAMPING = "the record of {span_min:.3g} min does not determine the damping ratio at {hz:.4g} Hz; about {needed_min:.2g} min would give it to 30 %"
    SHORT_FOR_SPECTRUM = "the record of {span_s:.3g} s is too short for its spectrum to show a mode"
    NO_BAND = "no band of the spectrum holds a mode with odds above 0.9 ({count} examined, record of {span_min:.3g} min)"
    # a measured input
    OUTPUTS_SPARSE = "the outputs have a value in {percent:.0f} % of the rows of the input {input}: they were recorded at a lower rate; low-pass the input, and give it at the times of the outputs"
    INPUT_MISSING = "the input {input} is missing in {percent:.0f} % of the samples, more than {most_percent:.0f} %: record it throughout and at the rate of the outputs, cut the record by onset_s and end_s to where it is given, or identify the outputs alone"
    INPUT_STILL = "the input {input} does not move (standard deviation {sd:.3g} {unit}, noise {noise:.3g}): identify the outputs alone, as a free decay"
    INPUT_HELD = "the input {input} keeps each value for {count:.0f} samples: it was recorded at a lower rate than the outputs; record it at their rate, or give both at the times at which it was recorded"
    INPUT_CLIPPED = "the input {input} is clipped: many samples share its extreme value, so that the true input is not known; reduce the amplitude or use a larger range"
    INPUT_SLOWER = "it was recorded at {rate_hz:.4g} Hz, slower than the outputs at {own_hz:.4g} Hz: record it at their rate at least"
    FEW_WITH_INPUT = "only {found} samples lie within onset_s and end_s, but at least {least} are needed"
    FEW_OF_INPUT = "the input {input} is recorded for {found} samples in a row, {least} are needed"
    BURSTS = "the samples lie in bursts: {missing} of {count} are missing at their usual step; give one burst by onset_s and end_s"
    NO_RESPONSE = "no mode exceeds the noise in the response to {input}; excite the structure over the frequencies of its modes, or identify the outputs alone"
    NO_LAG = "the lag of the input {input} {problem}: the input may be that of another record, or late by more; bring both to the same clock, and give what is left by input_lag_ms"
    LAG_AT_LIMIT = "lies at the limit of the search, {limit_ms:.3g} ms"
    LAG_UNCERTAIN = "is not determined: its standard deviation is {sd_ms:.3g} ms"
    LAG_WIDE = "is not determined: {low_ms:.3g} to {high_ms:.3g} ms explain the outputs alike"
    LAG_AMBIGUOUS = "is not unique: several explain the outputs alike"
    LAG_LONG = "the lag of the input {input}, {lag_ms:g} ms, leaves less than {percent:.0f} % of the record of {span_s:.3g} s: bring both to one clock"
    DAMPING_OPEN = "the response does not determine its damping ratio ({zeta:.3g}, sd {sd:.2g}): {advice}"

    def __init__(self, words: str, next_step: str = "") -> None:
        self.words, self.next_step = words, next_step

    def __call__(self, **values: object) -> Refusal:
        """The refusal with these values in the places of the sentence."""
        kept = {name: one if isinstance(one, int | float) else str(one) for name, one in values.items()}
        return Refusal(self.words.format(**values), "", self.next_step, (self.name,), kept)


class Note(Enum):
    """What is told of a result, and clauses of other sentences; called with the values of its sentence, the words."""

    # samples
    PAUSE = "The record pauses for {gap_s:.4g} s: only the {count} samples from {start_s:.4g} s to {end_s:.4g} s were used. Give the others as files of their own."
    RATE = "{rate_hz:.4g} Hz from {start_s:.4g} s"
    RATES = "The sampling rate changes within the record ({rates}): only the stretch from {start_s:.4g} s to {end_s:.4g} s was used. Give the others as files of their own."
    CLIPPED_UNTIL = "The signal is clipped (many samples at its extreme value) until {until_s:.4g} s; only the samples after it were used."
    CHANNEL = "Channel {names} was left out: {why}."
    CHANNELS = "Channels {names} were left out: {why}."
    FEW_VALUES = "only {found} of {count} samples have a value"
    NEVER_CHANGES = "it never changes (always {value:g} {unit})"
    AT_REST = "no motion (the values change by less than {percent:g} % of their standard deviation)"
    MORE_NAMES = "{names} and {count} more"
    ONE_REPEATED = "1 sample repeats the one before ({places}): frozen or duplicated frames. It was left out."
    REPEATED = (
        "{count} samples repeat the one before ({places}): frozen or duplicated frames. They were left out."
    )
    FIRST_AT = "first at {first_s:.4g} s"
    LAST_ROWS = "the last {count} of the record"
    ONE_COMPONENT = "The modes are fitted in 1 component of the {channels} channels; {rejected} samples of single channels that differ from them by more than 5 sd were left out."
    COMPONENTS = "The modes are fitted in {count} components of the {channels} channels; {rejected} samples of single channels that differ from them by more than 5 sd were left out."
    ONE_ROW_IN = "Only one row in {held} carries a sample ({rate_hz:.4g} of {row_rate_hz:.4g} Hz; the others repeat it or are empty): frequencies are the lowest that fit, below half that rate."
    # parts of the record
    SEGMENT = "{kind} from {start_s:.4g} s to {end_s:.4g} s"
    RECORD_SHOWS = "The record shows: {segments}."
    HELD = "Held: the motion goes on at the frequency of the free decay, with a much larger damping ratio."
    CLICK = "A click; the motion goes on as before."
    EVENT_ENDS_DECAY = "An event ends the decay; give end_s to use what follows."
    STOPPED = "The motion was stopped."
    STEADY_AT = "Steady motion at {hz:.4g} Hz."
    DRIVE_CHANGES = "The drive changes."
    HELD_UNTIL_RELEASE = "Held until the release."
    CHANGES_AROUND = "The motion changes before and after."
    REPEATED_RUN = "{count} samples repeat the one before and were left out."
    ROUGH = "Free decays leave {percent:.2g} % of the power: the intervals include the differences between parts of the decay."
    MOVES_MOST = "from {start_s:.4g} s to {end_s:.4g} s, channel {channel} moves most, by +-{half:.3g} {unit}, and its noise has a standard deviation of {noise:.2g} {unit}"
    FULLEST_BAND = "; {percent:.0f} % of its power lies within 5 % of {hz:.4g} Hz"
    # start of a decay
    USER_ONSET = "The start of the free decay was given by the user."
    RECORD_START = "No change from driven to free motion was found: the motion decays freely from the first sample that is used."
    STOP = "Steady shaking at {hz:.4g} Hz ends at {stop_s:.5f} s (sd {sd_s:.2g} s), {located} The following {late_s:.3g} s ({cycles:.2g} cycles) are not fitted: transients of higher modes are still present."
    BY_CHANGE = "located to about one cycle by the change from driven motion to a free decay."
    BY_FITS = "located where the fits of the steady vibration and of the free decays ({hz} Hz) join."
    BY_FITS_WITH_BASE = "located where the fits of the steady vibration and of the free decays ({hz} Hz), including the tracked motion of the base, join."
    AFTER_DRIVE = "Steady motion ends here; no decay was recognised, and all that follows was fitted as one."
    RELEASE = "The structure is released at {time_s:.4g} s: the decay starts there. The fit begins {settling_s:.3g} s later, when the shortest transients are over."
    PEAK = "The structure is released at {time_s:.4g} s, its largest deflection: the decay starts there."
    INTERRUPTION = (
        "The motion is interrupted at {start_s:.4g} s and goes on: it is fitted from {end_s:.4g} s."
    )
    MOTION_CHANGES = "The motion changes at {time_s:.4g} s: it is fitted from there."
    NOT_USED = "The fit does not use {names}: no motion above the noise after the onset."
    OUTLIERS = "{count} of {total} samples were rejected as outliers (more than 5 sd from the fitted model)."
    CLUSTERS = "Up to {percent:.1f} % of the samples of a channel deviate from the fitted model by more than 5 sd, in clusters rather than at random: they were kept, and the noise level includes them. Inspect the residual."
    MISSING = "{count} samples of the decay are missing; they were left out, not interpolated."
    SEVERAL_DECAYS = "The record contains {count} free decays; {used} Figures show the decay from {start_s:.4g} s to {end_s:.4g} s."
    ONE_DECAY = "the values are those of the most informative decay, since no other one shows its modes."
    COMBINED = "the values of up to {count} of them that show the same mode are combined, and the scatter between them is part of the standard deviations."
    OTHER_DECAY = "Only the decay from {start_s:.4g} s to {end_s:.4g} s shows this mode: its shape and amplitude are those there, and the figures of the decay do not show it."
    RATE_ERROR = "The frame rate is known to {ppm:g} ppm (relative sd): the interval of every frequency includes it. The error is common to all modes and to all recordings of one camera, and does not affect damping ratios. If the rate is known better, give fps_tolerance_ppm."
    # modes
    CONVERTED = "Frames fit a converted rate ({how}): {ratio:.4g} recorded ones for each in the file; if the rate given is the camera's, the frequency is {true_hz:.4g} Hz instead of {hz:.4g} Hz."
    MOVED = "recorded ones were left out or repeated"
    BLENDED = "means of two recorded ones"
    INSERTED = "those without positions repeat others"
    MULTIPLE = "{factor} x {hz:.4g} Hz"
    ALIASED = "{terms} ({true_hz:.4g} Hz, aliased by the {rate_hz:.4g} Hz of sampling)"
    SHAPE_DISAGREES = "Shape disagrees with theory (MAC {mac:.2g})."
    SHAPE_TURNED = (
        "Shape disagrees with theory (MAC {mac:.2g}); with the clamp at the other end {turned_mac:.2g}."
    )
    ALIAS = "At a sampling rate of {rate_hz:.4g} Hz, a vibration at {others} Hz cannot be distinguished from one at {hz:.4g} Hz."
    ALIAS_OF_THEORY = "At a sampling rate of {rate_hz:.4g} Hz, mode {number}, which theory predicts at {theory_hz:.4g} Hz, would appear near {hz:.4g} Hz."
    UP_TO = "among frequencies up to {limit_hz:.5g} Hz"
    NOT_TOLD_APART = "{hz:.5g} Hz or, {up_to}, {others} Hz: no recording tells them apart from samples at {rate_hz:.5g} Hz. Record the structure again at another rate."
    LIKELY = "{hz:.5g} Hz with {probability:.2g}"
    UNDECIDED = "identified at {hz:.5g} Hz, undecided {up_to}: {likely}. Record again at a higher rate."
    NO_ALIAS = "{hz:.5g} Hz (odds {odds}:1 {up_to}), no alias"
    IS_ALIAS = "{true_hz:.5g} Hz (odds {odds}:1 {up_to}), not {hz:.5g} Hz"
    ROLLING_SHUTTER = "The phases of the mode shapes {grow} down the image by {row_us:.3g} ± {sd_us:.1g} µs per row: a rolling shutter exposes one row after another. Set readout_s = {readout_s:.3g} in [camera] (sd {sd_s:.1g} s), so that all markers refer to one time."
    # the target
    FITTING_RATE = "at a sampling rate of {rate} (recorded: {recorded_hz:.4g} Hz), a ratio of {ratio:.3g}, the strongest line, {hz:.4g} Hz, would be mode {number} of the beam"
    UNLESS = "{fitting}, unless it is mode {number} at the recorded rate"
    MODES_AT = "the modes found are at {hz} Hz"
    OTHER_SHAPE = "the mode found at {hz:.4g} Hz has another shape"
    THOUSANDTH = "{hz:.4g} Hz is a thousandth of it: {cause}"
    THOUSANDFOLD = "{hz:.4g} Hz is 1000 times it: {cause}"
    UNIT_OF_BEAM = "a quantity of the beam is in another unit"
    UNIT_OF_RATE = "give the frame rate in Hz, not in kHz"
    UNIT_OF_RATE_OR_BEAM = "give the frame rate in Hz, not in kHz, or the beam in mm, not in m"
    UNIT_OF_TARGET = "give the requested frequency in Hz, not in kHz"
    APPEARS = "At a sampling rate of {rate_hz:.4g} Hz, {hz:.4g} Hz would appear at {alias_hz:.4g} Hz: record at more than {least_hz:.4g} Hz or request the alias"
    CHECK_RATE = "Check the requested frequency and the recorded frame rate, with which all frequencies scale"
    # ambient excitation
    DAMPING_KNOWN = "This record of {span_min:.3g} min ({cycles:.0f} cycles) gives the damping ratio, {zeta:.3g} %, to {percent:.2g} % of its value; {needed_min:.2g} min would give it to {aim:.2g} %."
    RECORD_LONGER = "record longer, closer, or with more excitation"
    FILLED = "{count} missing samples were filled by linear prediction from both sides: the spectrum changes by {percent:.2g} % at most, frequencies and damping ratios less."
    # a measured input
    RESPONSE = "The response to {input} was fitted, {part}."
    WHOLE = "from the first sample to the last"
    PART = "from {start_s:.4g} to {end_s:.4g} s"
    WITHOUT_GAP = "{part}, the longest part without a gap of the input"
    INPUT_LATE = 'The outputs follow {input} better with a lag of {lag_ms:.3g} ms: bring both to one clock, or give input_lag_ms (a number or "auto").'
    INPUT_INCOMPLETE = 'What the fit leaves near {hz} Hz follows the input as modes would that the record does not determine. Allow more modes (max_modes); filter the input below half the sampling rate before it is sampled, or raise that rate; bring input and outputs to one clock (input_lag_ms = "auto").'
    EXCITE = "excite it longer or more strongly"
    STATED = "as stated"
    FLOOR = "from the floor of its spectrum, {low_hz:.4g} to {high_hz:.4g} Hz"
    NOISE_UNKNOWN = "The noise of the input {input} is unknown: its spectrum has no flat floor. What the fit leaves at the resonances gives {sd:.2g} {unit}, at most {most:.2g}. Give it: record the input at rest for a second, and state its standard deviation."
    NOISE_LARGE = "Noise of the input {input} ({sd:.2g} {unit}, {source}) exceeds that of the outputs at the resonance of {hz}: it was corrected for, and determines the intervals. A less noisy sensor narrows them."

    def __init__(self, words: str) -> None:
        self.words = words

    def __call__(self, **values: object) -> str:
        """The words with these values in their places."""
        return self.words.format(**values)

    @property
    def beginning(self) -> str:
        """The words before the first value."""
        return self.words.partition("{")[0]


def in_hz(frequencies: Iterable[float]) -> str:
    """Frequencies for a sentence, without their unit."""
    return ", ".join(f"{hz:.4g}" for hz in frequencies)


class ModeFlag(Enum):
    """Name of a flag, as in the flags column; its value is the description in report and documentation."""

    DRIVEN = (
        "The motion is steady throughout: its frequency is that of the drive, not a natural frequency, and damping "
        "cannot be measured. Record the free decay after the drive stops."
    )
    MAY_BE_DRIVEN = (
        "The motion may be driven: its amplitude decreases by less than 40 %, and the probability that it is a drive "
        "exceeds 5 %. The damping ratio then means nothing. Record until the motion has decayed, or give onset_s where "
        "it is known to be free."
    )
    DECAYS_DIFFER = (
        "The damping ratios of the decays differ by more than those of one structure usually do: a hand may hold one, or "
        "a drive may go on. The value is their mean, which may be that of none. Compare the decays that the report "
        "lists, and give onset_s and end_s of one."
    )
    MAY_BE_HELD = (
        "The mode follows a motion that may be free, or a drive whose end was not recognised: a hand that stops the "
        "motion looks like strong damping. The interval of the damping ratio includes that doubt. The values are those "
        "of the structure only if nothing touched it."
    )
    SHORT_RECORD = "The record contains fewer than ten cycles of the mode after the onset."
    ADDED = (
        "The mode was fitted because add_hz names it: its line does not exceed the threshold of the search."
    )
    LOW_SNR = "The amplitude of the mode is less than ten times the noise of a single sample."
    AMPLITUDE_DEPENDENT = (
        "Damping or frequency depends on the amplitude: the constant values are averages over this record, and their "
        "standard deviations include the distances to the values at small amplitude and at the start. Use the values "
        "at small amplitude, or the curve; those at the start if a hand may have damped the end."
    )
    CLOSE_MODE = "Another mode within 10 % of this frequency is also excited."
    CHAIN_TOO_SHORT = (
        "The sampler reached its maximum number of steps before the autocorrelation criterion was met."
    )
    ALIASED_POSSIBLE = (
        "The frequency is close to half the sampling rate, or to the alias of a beam mode above half the sampling "
        "rate: the true frequency may be different. Record at another frame rate to decide."
    )
    FEW_CYCLES_LOST = (
        "The amplitude decreased by less than 40 % during the record: a dependence of damping on amplitude would "
        "hardly be visible. The damping ratio is that at the amplitudes of the record; the interval of its value at "
        "small amplitude allows for what cannot be seen. Record longer."
    )
    UNRESOLVED = (
        "Two modes too close to be resolved in this record explain the motion better than one mode, with constant "
        "or amplitude-dependent damping: the values may belong to neither. Record longer."
    )
    NOT_CONFIRMED = (
        "Covariance-driven stochastic subspace identification, used as an independent check, has no stable pole at "
        "this frequency."
    )
    MANY_OUTLIERS = (
        "In at least one channel, more than 3 % of the samples deviate from the fitted model by more than five "
        "standard deviations."
    )
    HARMONIC = (
        "Frequency and decay rate are those of a harmonic or combination tone of stronger modes: it may be a "
        "distortion of their motion."
    )
    DAMPING_TOUCHES_ZERO = (
        "The damping ratio is less than two sd above zero; the prior admits positive values only."
    )
    SHAPE_DISAGREES = (
        "The shape is not that of the beam's mode with this number: frequency and damping ratio may belong to another "
        "mode, or the positions are wrong. Check clamp_side and positions_mm: both are counted from the clamp."
    )
    RATE_CONVERTED = (
        "The frames are not evenly spaced in time, as in a file whose frame rate was converted by leaving out, "
        "repeating or blending frames: the frequency may be wrong by the ratio of the two rates. Use the file as the "
        "camera wrote it."
    )
    RESIDUAL_AT_MODE = (
        "What the fit leaves at the frequency of the mode has more than four times the power of the noise beside it: "
        "the motion is not of the form that was fitted. The standard deviations were increased accordingly."
    )
    INPUT_LATE = (
        "The measured input explains the motion better when it is shifted in time: input and outputs do not share a "
        "clock, or a sensor delays one of them. Frequency and damping ratio may be wrong."
    )
    INPUT_INCOMPLETE = (
        "What the fit leaves follows the measured input as more modes would, which the record does not determine: "
        "modes are missing, the input holds frequencies above half the sampling rate, something else drives the "
        "structure in step with it, or the motion is not linear. The standard deviations are those if all that is left "
        "near the mode is such a response, and not noise."
    )

    @property
    def usual_severity(self) -> Severity:
        """Severity where the effect of the flag on the result was not computed."""
        return _USUAL.get(self, Severity.INFORMATION)


# Flags of a mode whose own note console and report quote, and how that begins.
QUOTED = {
    ModeFlag.MAY_BE_DRIVEN: ModeFlag.MAY_BE_DRIVEN.value,
    ModeFlag.SHAPE_DISAGREES: Note.SHAPE_DISAGREES.beginning,
    ModeFlag.RATE_CONVERTED: Note.CONVERTED.beginning,
    ModeFlag.INPUT_LATE: Note.INPUT_LATE.beginning,
    ModeFlag.INPUT_INCOMPLETE: Note.INPUT_INCOMPLETE.beginning,
}


def quoted_note(flag: ModeFlag, notes: Iterable[str]) -> str:
    """The note that says what a flag of a mode means for it; empty where there is none."""
    start = QUOTED.get(flag)
    return next((note for note in notes if start is not None and note.startswith(start)), "")


def alias_note(rate_hz: float, hz: float, count: int = 1) -> str:
    """The note that at this sampling rate the next `count` of the frequencies above fit as well as `hz`."""
    others = in_hz((rate_hz - hz, rate_hz + hz, 2.0 * rate_hz - hz)[:count]) + ", …" * (count > 1)
    return Note.ALIAS(rate_hz=rate_hz, others=others, hz=hz)


_USUAL = {
    ModeFlag.DRIVEN: Severity.WRONG,
    ModeFlag.MAY_BE_DRIVEN: Severity.WRONG,
    ModeFlag.DECAYS_DIFFER: Severity.WRONG,
    ModeFlag.MAY_BE_HELD: Severity.WRONG,
    ModeFlag.ALIASED_POSSIBLE: Severity.WRONG,
    ModeFlag.UNRESOLVED: Severity.WRONG,
    ModeFlag.HARMONIC: Severity.WRONG,
    ModeFlag.RESIDUAL_AT_MODE: Severity.WRONG,
    ModeFlag.SHAPE_DISAGREES: Severity.WRONG,
    ModeFlag.RATE_CONVERTED: Severity.WRONG,
    ModeFlag.INPUT_LATE: Severity.WRONG,
    ModeFlag.NOT_CONFIRMED: Severity.WRONG,
    ModeFlag.INPUT_INCOMPLETE: Severity.INTERVAL,
    ModeFlag.AMPLITUDE_DEPENDENT: Severity.INTERVAL,
    ModeFlag.FEW_CYCLES_LOST: Severity.INTERVAL,
    ModeFlag.MANY_OUTLIERS: Severity.INTERVAL,
    ModeFlag.DAMPING_TOUCHES_ZERO: Severity.INTERVAL,
    ModeFlag.CHAIN_TOO_SHORT: Severity.INTERVAL,
}

#: Of each check of the residual its name, what a small p-value tells, and what to do.
CHECKS = (
    (
        "unmodelled vibration",
        "A vibration was not modelled: a weak mode, mains hum, or a harmonic of a strong mode.",
        "Where it changes the values by more than a standard deviation, remove its source and record again.",
    ),
    (
        "correlation of neighbouring residuals",
        "The noise is correlated in time, or contains fast motion.",
        "The intervals already include the noise level at the mode (noise factor); stabilise camera and lighting.",
    ),
    (
        "power just above the baseline's band",
        "A drift is faster than the baseline: camera motion, changing light, or a slow swing.",
        "Add a reference marker on a fixed point; keep camera and lighting steady.",
    ),
    (
        "score for damping that depends on amplitude",
        "The decay may not be exponential: damping that depends on the amplitude, or noise that is not white.",
        "The recording states whether a dependence is established; record smaller amplitudes, or longer.",
    ),
    (
        "kurtosis of the residual",
        "Single samples deviate strongly: lost or wrongly located markers, or shocks.",
        "Inspect the frames with the largest residuals; improve lighting and markers.",
    ),
)

"""What no command accepts: it is refused in a few words that say why, and nothing is written or changed."""

import os
import shlex

import pytest
from kit.attacks import content
from support.paths import APPS, COMMANDS_OF_APPS

from modalcam.common import ExitCode

LONG = "9" * 5000
NO_END = [("--time-limit", "inf"), ("--time-limit", "nan"), ("--memory-limit", "inf")]
NO_END += [("--memory-limit", "1e30"), ("--fps", "1e999999999"), ("--fps", LONG), ("--fps", "1/0")]
IDENTIFY = "identify table.csv -o out"
WRITING = ["run videos -o", "figures videos -o", "studio videos -o", "init videos -o", "markers -o", "demo"]
# A command, what it says, and the text of experiment.toml.
REFUSED = [
    # what is not there, or is something else
    ("run absent -o out", "no such folder"),
    ("identify absent.csv -o out", "cannot be read"),
    ("identify empty -o out", "expected a regular file, found a folder"),
    ("report absent", "modalcam run"),
    ("simulate absent", "modalcam run"),
    ("probe absent", "no such file"),
    ("check-config absent.toml", "cannot be read"),
    ("render absent.toml -o x.avi", "cannot be read"),
    ("render empty -o x.avi", "holds no results"),
    ("render absent.toml -o x.avi --recording a", "expected the folder of a finished run"),
    ("render empty -o x.avi --bare", "--bare: expected a configuration"),
    ("render empty -o x.avi --truth x.npz", "--truth: expected a configuration"),
    ("calibrate empty -o c.toml", "no images"),
    *(
        (f"{command} {source}", "expected a regular file")
        for command in ("check-config", "identify -o out")
        for source in ("pipe", "/dev/zero", ".")
        if (command, source) != ("check-config", ".")
    ),
    ("check-config empty", "experiment.toml: cannot be read"),
    ("identify clip.avi -o out", "modalcam run"),
    *(
        ("check-config experiment.toml", "expected a regular file", f'[camera]\nlens = "{source}"\n')
        for source in ("pipe", "/dev/zero", "empty")
    ),
    # values that cannot be
    *((f"run videos -o out {option} {value}", option) for option, value in NO_END),
    ("run empty -o out --fps 240fps", "positive number"),
    ("run empty -o out --fps 0", "positive number"),
    ("paper empty -o out --fps 240fps", "positive number"),
    ("demo out --modes 9", "from 1 to 5"),
    ("markers --dots 1000000000 -o dots.pdf", "--dots"),
    ("markers --page a3 -o dots.pdf", "page"),
    ("calibrate empty -o c.toml --squares 7", "such as 7x5"),
    ("calibrate empty -o c.toml --marker-mm 40", "0 < --marker-mm"),
    ("calibrate empty -o c.toml --dictionary DICT_9X9", "expected one of"),
    (f"{IDENTIFY} --mode 51", "command line: mode: input should be less than or equal to 50"),
    (f"{IDENTIFY} --mode {LONG}", "--mode"),
    (f"{IDENTIFY} --seed {LONG}", "--seed"),
    (f"{IDENTIFY} --target-hz 0", "greater than or equal to 0.000000001"),
    (f"{IDENTIFY} --onset-s inf", "finite"),
    (f"{IDENTIFY} --end-s 0", "command line: end_s: input should be greater than 0"),
    # values that contradict each other
    (f"{IDENTIFY} --mode 2 --target-hz 12", "not both"),
    (f"{IDENTIFY} --onset-s 2 --end-s 1", "command line: end_s must be later than onset_s = 2, found 1"),
    (
        f"{IDENTIFY} --end-s 1 -c experiment.toml",
        "command line: end_s must be later than onset_s = 2, found 1",
        '[[recordings]]\nfile = "table.csv"\nonset_s = 2.0\n',
    ),
    # places that cannot be written, and files that are not results
    *((f"{command} {'a' * 300}", "") for command in WRITING),
    *((f"{command} loop/out", "") for command in WRITING),
    *((f"{command} -o -", "name") for command in ("run empty", "identify table.csv", "markers")),
    ("run videos -o videos", "never written among the recordings"),
    ("markers -o table.csv/markers.pdf", "cannot be written ("),
    ("markers -o dots.png", "ends in .svg or .pdf"),
    ("render absent.toml -o x.xyz", "expected a name ending in .avi, .mkv, .mp4, .mov; found"),
    ("demo .", "holds other files"),
    *(
        (command, "exists already", "[camera]\nfps = 100\n")
        for command in (
            "markers -o mine.svg",
            "plan experiment.toml -o experiment.toml",
            "init videos -o experiment.toml",
            "render experiment.toml -o clip.avi",
            "calibrate empty -o experiment.toml",
        )
    ),
    # configurations that exhaust a parser
    *(
        ("check-config experiment.toml", words, text)
        for text, words in (
            (f"[camera]\nfps = {LONG}", "not valid TOML"),
            ("a = " + "[" * 100_000, "nested too deeply"),
            ("a" + ".a" * 30_000 + " = 1", "keys of at most three parts"),
            ("'a'" + " . 'a'" * 30_000 + " = 1", "keys of at most three parts"),
            ('[camera]\nfps = "1e999999999"', "camera.fps"),
            ("[camera]\nfps = 100\nfps = 200", "not valid TOML"),
            ('"fps\\u001b[2J" = 3', "\\x1b[2J"),
        )
    ),
]
NO_INPUT = [("run empty", "no recordings"), ("run empty -o out", ".avi"), ("paper empty -o out", ".avi")]
CASES = [(ExitCode.USAGE, *case) for case in REFUSED] + [(ExitCode.NO_INPUT, *case) for case in NO_INPUT]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[1]} {case[2]}"[:70])
def test_it_is_refused_in_few_words_and_nothing_is_written(modalcam, tmp_path, monkeypatch, in_process, case):
    code, command, words, *text = case
    if not APPS and command.split()[0] in COMMANDS_OF_APPS:
        pytest.skip("modalcam/apps was deleted")
    for name in ("empty", "videos"):
        (tmp_path / name).mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    for name in ("table.csv", "videos/series.csv"):
        (tmp_path / name).write_text("time_s,y\n0,1\n")
    for name in ("videos/film.avi", "clip.avi", "mine.svg"):
        (tmp_path / name).write_bytes(b"RIFF")
    for one in text:
        (tmp_path / "experiment.toml").write_text(one)
    monkeypatch.chdir(tmp_path)
    before = content(tmp_path)
    found, _, err = modalcam(*shlex.split(command))
    assert found == code, err
    assert words in err
    assert "Traceback" not in err
    assert len(err) < 1000
    assert content(tmp_path) == before

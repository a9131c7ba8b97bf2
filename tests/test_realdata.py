"""The table of real recordings and the command that fetches them, from a server of this test."""

import functools
import hashlib
import http.server
import threading

import pytest
from support.paths import REALDATA, REALDATA_ABSENT

from tests import realdata


@pytest.fixture
def server(tmp_path):
    """Folder that is served, and its address."""
    folder = tmp_path / "served"
    folder.mkdir()
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=folder)
    handler.func.log_message = lambda *_: None
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield folder, f"http://127.0.0.1:{running.server_port}"
        running.shutdown()
        thread.join()


def table_of(tmp_path, rows):
    table = tmp_path / "table.tsv"
    table.write_text("file\tlicence\tbytes\tsha256\tsource\n" + "".join("\t".join(r) + "\n" for r in rows))
    return table


def test_whole_files_are_written_and_others_are_named(server, tmp_path, capsys):
    served, address = server
    (served / "a b.npy").write_bytes(b"recording")
    (served / "LICENSE").write_bytes(b"MIT")
    (served / "changed.mp4").write_bytes(b"another")

    def row(file, content, source):
        return file, "MIT", str(len(content)), hashlib.sha256(content).hexdigest(), source

    table = table_of(
        tmp_path,
        [
            row("strip/run 1.npy", b"recording", f"{address}/a%20b.npy"),
            row("strip/LICENSE", b"MIT", f"{address}/LICENSE"),
            row("strip/changed.mp4", b"original", f"{address}/changed.mp4"),
            row("strip/gone.mp4", b"gone", f"{address}/gone.mp4"),
            row("strip/page.jpg", b"page", "by hand: https://example.org/page"),
        ],
    )
    folder = tmp_path / "realdata"
    assert realdata.main(table, folder) == 1
    printed = capsys.readouterr().out
    assert sorted(path.name for path in (folder / "strip").iterdir()) == ["LICENSE", "run 1.npy"]
    assert (folder / "strip" / "run 1.npy").read_bytes() == b"recording"
    assert "changed.mp4: expected 8 bytes of SHA-256" in printed
    assert "404" in printed
    assert "by hand: https://example.org/page" in printed
    assert "2 of 5 files" in printed
    before = (folder / "strip" / "LICENSE").stat().st_mtime_ns
    (served / "changed.mp4").write_bytes(b"original")
    assert realdata.main(table, folder) == 1
    assert "3 of 5 files" in capsys.readouterr().out
    assert (folder / "strip" / "LICENSE").stat().st_mtime_ns == before, "a whole file is not fetched again"


def test_the_table_names_a_licence_and_a_source_of_every_file():
    found = realdata.entries()
    assert len({entry.file for entry in found}) == len(found)
    for entry in found:
        assert entry.licence in {"MIT", "BSD-2-Clause", "BSD-3-Clause", "Apache-2.0"}
        assert entry.source.startswith(("https://raw.githubusercontent.com/", "by hand: https://github.com/"))
        assert len(entry.sha256) == 64
    folders = {entry.file.split("/")[0] for entry in found}
    licensed = {entry.file.split("/")[0] for entry in found if "/LICENSE" in entry.file}
    assert folders - licensed == set()


@pytest.mark.skipif(not REALDATA.is_dir(), reason=REALDATA_ABSENT)
def test_the_recordings_are_those_of_the_table():
    present = [entry for entry in realdata.entries() if (REALDATA / entry.file).is_file()]
    assert present
    assert [entry.file for entry in present if not realdata.is_whole(entry, REALDATA)] == []

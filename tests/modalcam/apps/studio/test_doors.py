"""The running studio without a browser: rubbish on its websocket, and a report that is a link."""

import asyncio
import http.cookiejar
import subprocess
import time
import urllib.request

import websockets
from kit.films import write_decay
from support.studio import answer, running_studio

# Packets of no type, events of no page, and what is not JSON.
RUBBISH = [
    ["rubbish"],
    ["9"],
    ["4" + "9" * 300],
    ["40["],
    ["40", "42[1"],
    ["40", '42["event","x"]'],
    ["40", '42["handshake",{}]'],
    ["40", '451-["x",{"_placeholder":true,"num":0}]', b"abc"],
    [b"\x00\xff"],
]


def cookie_of(address):
    """The cookie that the address with the token gives."""
    jar = http.cookiejar.CookieJar()
    with urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar)).open(address, timeout=30):
        return "; ".join(f"{one.name}={one.value}" for one in jar)


async def send_rubbish(address, cookie):
    base = address.split("/?")[0]
    target = base.replace("http:", "ws:") + "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    for messages in RUBBISH:
        async with websockets.connect(
            target, origin=base, additional_headers={"Cookie": cookie}
        ) as connection:
            await connection.recv()
            for message in messages:
                await connection.send(message)
                await asyncio.sleep(0.05)


def test_rubbish_and_links_are_answered_without_a_word(tmp_path):
    folder, out = write_decay(tmp_path / "videos"), tmp_path / "out"
    (tmp_path / "private.html").write_text("secret")
    with running_studio("studio", folder, "-o", out, cwd=tmp_path, stderr=subprocess.PIPE) as (address, ran):
        cookie = cookie_of(address)
        out.mkdir(exist_ok=True)
        (out / "report.html").symlink_to(tmp_path / "private.html")
        assert answer(address, "/report", Cookie=cookie)[0] == 404, "a link leads out of the folder"
        (out / "report.html").unlink()
        (out / "report.html").write_text("own")
        assert answer(address, "/report", Cookie=cookie) == (200, b"own")
        assert answer(address, "/anything", Cookie=cookie)[0] == 404
        asyncio.run(send_rubbish(address, cookie))
        # the exception of a task is reported when the task is collected
        time.sleep(0.5)
        assert answer(address, "/", Cookie=cookie)[0] == 200, "the studio still answers"
        ran.send_signal(2)
        said = ran.stderr.read()
    assert said.count("\n") == 1, said
    assert "Ctrl-C ends the studio" in said

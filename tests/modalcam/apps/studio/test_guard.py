"""Requests that are let through to the studio, and those that are refused: other hosts, origins, sites, keys."""

import asyncio

import pytest

from modalcam.apps.studio import MOST_BODY_BYTES, Guard

PORT = 4321
HOST = f"127.0.0.1:{PORT}"


async def behind(scope, receive, send):
    """The application behind the guard; a test sees its answer only where the guard lets a request through."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"secret"})


GUARD = Guard(behind, PORT)


def ask(path="/", query="", method="GET", kind="http", **headers):
    """Status or type of the answer, headers and body."""
    sent = []

    async def receive():
        return {"type": f"{kind}.connect"}

    async def send(message):
        sent.append(message)

    listed = [(k.replace("_", "-").encode(), v.encode()) for k, v in headers.items() if v is not None]
    scope = {"type": kind, "method": method, "path": path, "query_string": query.encode(), "headers": listed}
    asyncio.run(GUARD(scope, receive, send))
    found = {name.decode(): value.decode() for name, value in sent[0].get("headers", ())}
    return sent[0].get("status", sent[0]["type"]), found, b"".join(m.get("body", b"") for m in sent)


def cookie():
    """The cookie that the address with the token gives."""
    status, headers, body = ask(query=f"token={GUARD.token}", host=HOST)
    assert status == 200
    assert b"secret" not in body
    value, *rules = headers["set-cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} == set(rules)
    assert GUARD.token not in value
    return value


@pytest.mark.parametrize("host", [HOST, f"localhost:{PORT}"])
def test_the_own_page_is_let_through(host):
    given = {"host": host, "cookie": f"other=1; {cookie()}", "sec_fetch_site": "same-origin"}
    status, headers, body = ask("/frame/0/0.png", **given)
    assert (status, body) == (200, b"secret")
    assert "default-src 'self'" in headers["content-security-policy"]
    assert headers["referrer-policy"] == "no-referrer"
    posted = ask("/_nicegui/x", method="POST", origin=f"http://{host}", content_length="10", **given)
    assert posted[0] == 200
    assert ask("/_nicegui_ws/x", kind="websocket", origin=f"http://{host}", **given)[0] == "websocket.accept"


def test_the_report_has_an_origin_of_its_own():
    """Its scripts cannot read what the studio's page can: it may come from another machine."""
    status, headers, _ = ask("/report", host=HOST, cookie=cookie(), sec_fetch_site="none")
    assert status == 200
    policy = headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts;")
    assert "'self'" not in policy.replace("frame-ancestors 'self'", "")


@pytest.mark.parametrize("path", ["/x", "/report/", "/report/../x", "/frame", "/experiment.toml", "//report"])
def test_unknown_paths_are_not_found(path):
    assert ask(path, host=HOST, cookie=cookie())[0] == 404
    assert ask(path, host=HOST)[0] == 403, "without the cookie, nothing is told"


REFUSED = {
    "no cookie": (403, {"cookie": None}),
    "wrong cookie": (403, {"cookie": f"modalcam-studio-{PORT}=guess"}),
    "cookie of another port": (403, {"cookie": "modalcam-studio-1=x"}),
    "broken cookie": (403, {"cookie": "a=b;;;\x7f=\\"}),
    "other host": (421, {"host": "evil.example"}),
    "rebound name": (421, {"host": f"evil.example:{PORT}"}),
    "other port": (421, {"host": "127.0.0.1:80"}),
    "no host": (421, {"host": None}),
    "name that ends alike": (421, {"host": f"evil-127.0.0.1:{PORT}"}),
    "other origin": (403, {"origin": "http://evil.example"}),
    "origin of another port": (403, {"origin": "http://127.0.0.1:8888"}),
    "opaque origin": (403, {"origin": "null"}),
    "https origin": (403, {"origin": f"https://{HOST}"}),
    "page of another site": (403, {"sec_fetch_site": "cross-site"}),
    "page of another port": (403, {"sec_fetch_site": "same-site"}),
}


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize("case", REFUSED)
def test_everything_else_is_refused(case, kind):
    status, wrong = REFUSED[case]
    given = {"host": HOST, "cookie": cookie(), "origin": f"http://{HOST}", "content_length": "0"} | wrong
    found, _, body = ask("/_nicegui_ws/socket.io/", kind=kind, **given)
    assert found == (status if kind == "http" else "websocket.close"), case
    assert b"secret" not in body


def test_a_websocket_and_a_change_must_name_their_origin():
    given = {"host": HOST, "cookie": cookie()}
    assert ask("/_nicegui_ws/x", kind="websocket", **given)[0] == "websocket.close"
    assert ask("/_nicegui/x", method="POST", content_length="1", **given)[0] == 403


@pytest.mark.parametrize("length", [str(MOST_BODY_BYTES + 1), "", "many", "-1"])
def test_large_and_endless_bodies_are_refused(length):
    given = {"host": HOST, "cookie": cookie(), "origin": f"http://{HOST}"}
    sent = {"content_length": length} if length else {}
    assert ask("/_nicegui/x", method="POST", **given, **sent)[0] == 413


@pytest.mark.parametrize(
    ("path", "query", "method", "headers"),
    [
        ("/", "token=", "GET", {}),
        ("/", "token=guess", "GET", {}),
        ("/", "", "GET", {}),
        ("/frame/0/0.png", "token={token}", "GET", {}),
        ("/", "token={token}", "POST", {}),
        ("/", "token={token}", "GET", {"origin": "http://evil.example"}),
        ("/", "token=\u00fc", "GET", {}),
    ],
)
def test_only_the_address_with_the_token_gives_a_cookie(path, query, method, headers):
    query = query.replace("{token}", GUARD.token)
    status, found, _ = ask(path, query=query, method=method, host=HOST, **headers)
    assert status == 403
    assert "set-cookie" not in found


def test_the_token_of_another_host_name_is_refused():
    assert ask(query=f"token={GUARD.token}", host=f"evil.example:{PORT}")[0] == 421


def test_every_studio_has_its_own_key():
    other = Guard(behind, PORT)
    assert other.token != GUARD.token
    assert len(other.token) >= 43  # 256 bits in base64
    assert other.address == f"http://{HOST}/?token={other.token}"

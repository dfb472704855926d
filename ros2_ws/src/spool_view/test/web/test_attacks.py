"""Attacks on the page: nothing is changed, nothing is read that should not be, the server lives on."""

from __future__ import annotations

import asyncio
import json
import stat
from collections.abc import Callable
from typing import Any

import pytest
from spool_view.acts import Outcome
from spool_view.application import own_host, same_origin

from .conftest import OWN, Station

ACT = {
    "act": "acknowledge",
    "valve": "valve_1",
    "alarm": "resonance",
    "occurrence": 3,
    "who": "Eva",
    "comment": "seen",
}


def test_an_operator_with_the_token_acknowledges_and_it_is_in_the_log(station: Station) -> None:
    answer = station.client.post("/act", json=ACT, headers=station.headers())
    assert answer.status_code == 200
    (act,) = station.asked
    assert (act.act, act.valve, act.alarm, act.occurrence, act.who) == (
        "acknowledge",
        "valve_1",
        "resonance",
        3,
        "Eva",
    )
    asked, done = map(json.loads, station.log.splitlines())
    assert (asked["step"], done["step"], done["who"], done["comment"]) == ("asked", "done", "Eva", "seen")


def test_a_refusal_of_the_monitor_is_said_and_in_the_log(make_station: Callable[..., Station]) -> None:
    station = make_station(outcome=Outcome(False, "resonance can't be reset: it is active"))
    answer = station.client.post("/act", json={**ACT, "act": "reset"}, headers=station.headers())
    assert (answer.status_code, answer.json()["text"]) == (409, "resonance can't be reset: it is active")
    assert json.loads(station.log.splitlines()[-1])["step"] == "refused"


def test_without_an_operator_the_page_is_read_only(make_station: Callable[..., Station]) -> None:
    station = make_station(operator=False)
    answer = station.client.post("/act", json=ACT, headers={"origin": OWN, "authorization": "Bearer x"})
    assert answer.status_code == 403
    assert "Read only" in station.client.get("/").text
    assert station.asked == []


@pytest.mark.parametrize("token", [b"", b"Bearer ", b"Bearer wrong", b"Basic abc", b"Bearer \xc3\xa9\xff"])
def test_a_wrong_token_changes_nothing(station: Station, token: bytes) -> None:
    answer = station.client.post("/act", json=ACT, headers={b"origin": OWN.encode(), b"authorization": token})
    assert answer.status_code == 401
    assert (station.asked, station.log) == ([], "")
    bare = station.client.post("/act", json=ACT, headers={"origin": OWN})
    assert bare.status_code == 401


def test_many_wrong_tokens_are_slowed_and_the_right_one_still_works(station: Station) -> None:
    wrong = {"origin": OWN, "authorization": "Bearer wrong"}
    codes = [station.client.post("/operator", headers=wrong).status_code for _ in range(30)]
    assert codes.count(401) <= 12
    assert codes[-1] == 429
    assert station.client.post("/operator", headers=station.headers()).status_code == 200


def test_operators_sign_in_by_name_and_act_under_that_name_only(make_station: Callable[..., Station]) -> None:
    station = make_station(people={"Eva": "correct horse", "Jan": "battery staple"})
    assert not list((station.desk.state_folder / "web_page").glob("token_*"))

    def signed_in(name: str, password: str) -> tuple[int, str]:
        answer = station.client.post(
            "/operator", json={"who": name, "token": password}, headers={"origin": OWN}
        )
        return answer.status_code, answer.json().get("token", "")

    assert signed_in("Eva", "battery staple") == signed_in("Nobody", "correct horse") == (401, "")
    code, token = signed_in("Eva", "correct horse")
    assert code == 200
    own = {"origin": OWN, "authorization": f"Bearer {token}"}
    assert station.client.post("/act", json={**ACT, "who": "Jan"}, headers=own).status_code == 200
    assert [act.who for act in station.asked] == ["Eva"]
    assert [json.loads(line)["who"] for line in station.log.splitlines()] == ["Eva", "Eva"]
    assert token not in station.log
    codes = [signed_in("Eva", "guess")[0] for _ in range(12)]
    assert codes[-1] == 429


def test_token_and_log_are_the_users_alone_and_the_token_goes_at_the_end(station: Station) -> None:
    assert station.desk.token is not None
    assert station.desk.log is not None
    for path in (station.desk.token.path, station.desk.log.path):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(station.desk.token.path.parent.stat().st_mode) == 0o700
    assert len(station.token) >= 43
    station.desk.token.remove()
    assert not station.desk.token.path.exists()


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "https://127.0.0.1:8765",
        "http://127.0.0.1:8766",
        "http://127.0.0.1:8765.evil.example",
        "",
    ],
)
def test_another_origin_reads_and_changes_nothing(station: Station, origin: str) -> None:
    headers = station.headers(origin=origin)
    assert station.client.post("/act", json=ACT, headers=headers).status_code == 403
    for path in ("/", "/stream/machine", "/trend?valve=valve_1", "/static/page.js"):
        assert station.client.get(path, headers={"origin": origin}).status_code == 403
    assert station.asked == []


def test_a_post_without_origin_or_from_another_site_is_refused(station: Station) -> None:
    headers = station.headers()
    del headers["origin"]
    assert station.client.post("/act", json=ACT, headers=headers).status_code == 403
    crossed = station.headers(sec_fetch_site="cross-site")
    assert station.client.post("/act", json=ACT, headers=crossed).status_code == 403
    embedded = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"}
    assert station.client.get("/trend?valve=valve_1", headers=embedded).status_code == 403
    followed = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}
    assert station.client.get("/", headers=followed).status_code == 200
    assert station.asked == []


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8765",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "",
        "a@127.0.0.1",
        "127.0.0.1:x",
    ],
)
def test_a_name_that_others_resolve_is_refused(station: Station, host: str) -> None:
    """DNS rebinding: the browser believes that the page is the attacker's."""
    assert station.client.get("/", headers={"host": host}).status_code == 421
    assert not own_host(host)


def test_localhost_and_addresses_are_this_host_by_any_port() -> None:
    assert all(map(own_host, ("localhost", "LOCALHOST:9000", "127.0.0.1:8765", "[::1]:80", "10.0.0.5:8765")))
    assert same_origin("http://localhost:9000", "localhost:9000")
    assert not same_origin("http://localhost", "localhost:9000")


@pytest.mark.parametrize(
    "path",
    [
        "/static/../page.html",
        "/static/..%2f..%2fpage_node.py",
        "/static/%2e%2e/%2e%2e/page_node.py",
        "/static//etc/passwd",
        "/static/texts_en.json",
        "/static/page.html",
        "/valve/../../etc/passwd",
        "/valve/%2e%2e%2fx",
        "/valve/a%00b",
        "/valve/<script>",
        "/web_page/token_8765",
        "/static/uplot/LICENSE",
    ],
)
def test_no_path_leads_to_a_file_that_is_not_of_the_site(station: Station, path: str) -> None:
    assert station.client.get(path).status_code == 404


def test_trends_are_read_of_valves_that_are_heard_only(station: Station) -> None:
    secret = station.desk.state_folder / "web_page" / "monitor"
    secret.mkdir()
    (secret / "trends.sqlite").write_bytes(b"no database")
    for valve in ("../web_page", "web_page", "/etc", "", "valve_1/../web_page", "valve_1"):
        answer = station.client.get("/trend", params={"valve": valve, "range": "day"})
        assert answer.json() == {"parameters": [], "start": []}
        assert str(station.desk.state_folder) not in answer.text


@pytest.mark.parametrize(
    "content",
    [
        None,
        [],
        "x",
        {},
        {**ACT, "act": "suppress"},
        {**ACT, "valve": "valve_9"},
        {**ACT, "alarm": ""},
        {**ACT, "alarm": "friction_drift"},
        {**ACT, "who": " "},
        {**ACT, "who": "x" * 61},
        {**ACT, "who": 5},
        {**ACT, "comment": "a\nb"},
        {**ACT, "comment": "x" * 201},
        {**ACT, "occurrence": -1},
        {**ACT, "occurrence": True},
        {**ACT, "act": "shelve"},
        {**ACT, "act": "shelve", "minutes": -1},
        {**ACT, "act": "shelve", "minutes": 1e9},
        {**ACT, "act": "shelve", "minutes": "30"},
        {**ACT, "topic": "/cmd_vel"},
        {**ACT, "who": "a\x1b[31m"},
    ],
)
def test_what_is_no_act_is_refused(station: Station, content: Any) -> None:
    assert station.client.post("/act", json=content, headers=station.headers()).status_code == 400
    assert (station.asked, station.log) == ([], "")


def test_bodies_that_are_too_large_too_deep_or_no_json_are_refused(station: Station) -> None:
    for body in (b"x" * 1_000_000, b"[" * 4000, b"\xff\xfe", b'{"minutes": NaN', b""):
        headers = station.headers(content_type="application/json")
        assert station.client.post("/act", content=body, headers=headers).status_code == 400
    form = station.headers(content_type="text/plain")
    assert station.client.post("/act", content=json.dumps(ACT), headers=form).status_code in (400, 429)
    assert station.asked == []


def test_acts_are_limited_in_rate(station: Station) -> None:
    codes = [station.client.post("/act", json=ACT, headers=station.headers()).status_code for _ in range(30)]
    assert codes[0] == 200
    assert codes[-1] == 429
    assert len(station.asked) < 15


def test_an_act_that_cannot_be_logged_is_not_done(station: Station, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(**_fields: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(type(station.desk.log), "write", lambda _log, **fields: full(**fields))
    assert station.client.post("/act", json=ACT, headers=station.headers()).status_code == 503
    assert station.asked == []


def test_ten_thousand_requests_are_bounded(station: Station) -> None:
    codes: list[int] = []

    async def send(message: Any) -> None:
        if message["type"] == "http.response.start":
            codes.append(message["status"])

    async def attack() -> None:
        scope = {"type": "http", "method": "GET", "path": "/", "raw_path": b"/", "query_string": b""}
        for _ in range(10_000):
            given = {**scope, "headers": [(b"host", b"127.0.0.1")], "client": ("127.0.0.1", 1), "app": None}
            await station.application.asgi(given, None, send)  # type: ignore[arg-type]

    asyncio.run(attack())
    assert len(codes) == 10_000
    assert codes.count(200) < 2_000
    assert set(codes) == {200, 429}
    assert station.asked == []


def test_every_answer_forbids_what_comes_from_elsewhere(station: Station) -> None:
    for path in ("/", "/valve/valve_1", "/static/page.js", "/nothing", "/trend?valve=x"):
        headers = station.client.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy
        assert "access-control-allow-origin" not in headers
        assert headers["x-content-type-options"] == "nosniff"
        assert "server" not in headers


def test_the_language_link_leads_to_own_pages_only(station: Station) -> None:
    for back in ("//evil.example", "https://evil.example", "/valve/../x", "javascript:alert(1)"):
        assert station.client.get("/language/de", params={"to": back}).status_code == 404
    answer = station.client.get("/language/de", params={"to": "/valve/valve_1"})
    assert (answer.status_code, answer.headers["location"]) == (303, "/valve/valve_1")
    assert "samesite=strict" in answer.headers["set-cookie"].lower()
    assert station.client.get("/language/fr").status_code == 404


def test_other_methods_are_refused(station: Station) -> None:
    for method in ("PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"):
        assert station.client.request(method, "/act", headers=station.headers()).status_code == 405

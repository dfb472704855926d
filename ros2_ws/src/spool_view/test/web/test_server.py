"""The server over real connections: slow readers, silent ones, nonsense, and its end with streams open."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
from spool_monitor.listener import HeardValve
from spool_monitor.state_database import StateDatabase
from spool_view import application, channels
from spool_view.application import MOST_CONNECTIONS, MOST_STREAMS, ServerThread
from spool_view.channels import MOST_BEHIND, Reader
from spool_view.metrics import Metrics
from starlette.testclient import TestClient

from .conftest import OWN, PATIENCE, Station, good_health, until


class Served:
    def __init__(self, station: Station) -> None:
        self.station = station
        own = socket.socket()
        own.bind(("127.0.0.1", 0))
        self.port = own.getsockname()[1]
        self.thread = ServerThread(station.application, own)
        self.thread.start()

    def connect(self, path: str, buffer: int | None = None) -> socket.socket:
        one = socket.socket()
        if buffer:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        one.settimeout(PATIENCE)
        one.connect(("127.0.0.1", self.port))
        one.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\n\r\n".encode())
        return one

    def answers(self) -> bool:
        with self.connect("/static/style.css") as one:
            return b"200 OK" in one.recv(100)


@pytest.fixture
def served(station: Station) -> Iterator[Served]:
    made = Served(station)
    yield made
    made.thread.stop()


def read_until(one: socket.socket, mark: bytes) -> bytes:
    found = b""
    while mark not in found:
        part = one.recv(65536)
        assert part, found[-500:]
        found += part
    return found


def test_a_stream_begins_with_all_and_goes_on_with_changes(served: Served) -> None:
    with served.connect("/stream/machine") as one:
        assert b'"condition":"alarm"' in read_until(one, b'"whole":true')
        # The stand-in monitor has said its last word: nothing is known any more.
        assert b'"condition":"no_word"' in read_until(one, b'"whole":false')
        read_until(one, b"event: beat")


def test_who_comes_before_the_server_is_ready_is_answered(
    station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    ready, serve = threading.Event(), application.uvicorn.Server.serve

    async def later(server: application.uvicorn.Server, sockets: list[socket.socket]) -> None:
        await asyncio.to_thread(ready.wait)
        await serve(server, sockets)

    monkeypatch.setattr(application.uvicorn.Server, "serve", later)
    served = Served(station)
    try:
        with served.connect("/static/style.css") as one:
            ready.set()
            assert b"200 OK" in one.recv(100)
    finally:
        ready.set()
        served.thread.stop()


def test_the_server_ends_its_streams_as_it_ends(served: Served) -> None:
    streams = [served.connect("/stream/machine") for _ in range(20)]
    streams += [served.connect("/stream/valve/valve_1") for _ in range(5)]
    for one in streams:
        read_until(one, b"data:")
    served.thread.stop()
    for one in streams:
        with one, one.makefile("rb") as rest:
            assert rest.read().endswith(b"0\r\n\r\n")  # the last chunk


def test_a_reader_that_does_not_read_is_dropped_and_others_go_on(served: Served) -> None:
    """It may hold what the buffers hold, no more; the valve's channel goes away with it."""
    valves = served.station.desk.valves
    valves |= {f"v{number}": HeardValve(f"v{number}") for number in range(400)}
    slow = [served.connect("/stream/machine", buffer=4096) for _ in range(10)]
    with served.connect("/stream/machine") as good:
        read_until(good, b'"whole":true')
        until(lambda: len(application._OPEN) >= 11, "all are connected")
        begin = time.monotonic()
        while len(application._OPEN) > 1:
            assert time.monotonic() - begin < PATIENCE, len(application._OPEN)
            for number, heard in enumerate(list(valves.values())):
                heard.health = good_health(f"{begin} {time.monotonic()} {number} " + 200 * "x")
                heard.health_at = time.monotonic()
                heard.changes += 1
            read_until(good, b'"whole":false')
        assert served.answers()
    for one in slow:
        one.close()


def test_streams_are_bounded(served: Served) -> None:
    streams = [served.connect("/stream/valve/valve_1") for _ in range(MOST_STREAMS)]
    for one in streams:
        read_until(one, b"data:")
    with served.connect("/stream/machine") as more:
        assert b"503" in more.recv(100)
    assert served.station.desk.open == ["valve_1"]
    for one in streams:
        one.close()
    until(lambda: not served.station.desk.open, "streams that were closed are released")
    with served.connect("/stream/machine") as again:
        read_until(again, b"data:")


def test_a_connection_that_never_asks_is_ended(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(application, "HEAD", 0.5)
    silent = [socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE) for _ in range(50)]
    for one in silent:
        one.sendall(b"GET / HTTP/1.1\r\nHost: ")
    for one in silent:
        assert one.recv(100) == b""
        one.close()
    assert served.answers()


def test_half_open_requests_leave_metrics_answering(station: Station) -> None:
    desk = replace(station.desk, metrics=Metrics(station.desk.valves, {}))
    served = Served(replace(station, application=application.application(desk)))
    stream = served.connect("/stream/machine")
    read_until(stream, b'"whole":true')
    half = [socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE) for _ in range(400)]
    for one in half:
        with contextlib.suppress(ConnectionError):
            one.sendall(b"GET / HTTP/1.1\r\nHost: ")
    for _ in range(20):
        with served.connect("/metrics") as scrape:
            assert b"spool_valves 1" in read_until(scrape, b"spool_valves ")[:2000]
    read_until(stream, b"event: beat")  # who has asked stays
    assert len(application._OPEN) < MOST_CONNECTIONS
    for one in (stream, *half):
        one.close()
    served.thread.stop()


def test_half_of_a_second_request_ends_its_connection(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "HEAD", 0.5)
    with served.connect("/language/none") as one:
        read_until(one, b"no such language")
        one.sendall(b"GET / HTTP/1.1\r\nHost: ")
        assert one.recv(100) == b""


def test_who_does_not_read_an_answer_loses_the_connection(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "STALLED", 0.5)
    monkeypatch.setattr(application, "SEND_BUFFER", 4096)
    deaf = [served.connect("/static/uplot/uPlot.iife.min.js", buffer=2048) for _ in range(100)]
    until(lambda: not application._OPEN, "all are ended")
    assert served.answers()
    for one in deaf:
        one.close()


def test_nonsense_ends_a_connection_and_not_the_server(served: Served) -> None:
    for nonsense in (
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" * 20,
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"a" * 100_000,
        b"GET " + b"/" * 100_000 + b" HTTP/1.1\r\n\r\n",
        b"POST /act HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
        b"GET http://127.0.0.1/ HTTP/1.1\r\nHost: evil.example\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: evil.example\r\n\r\n",
    ):
        with socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE) as one:
            try:
                one.sendall(nonsense)
                assert b" 200 " not in one.recv(4096)
            except (ConnectionResetError, BrokenPipeError):
                pass
    assert served.answers()


def test_who_is_behind_is_dropped_once(monkeypatch: pytest.MonkeyPatch) -> None:
    dropped: list[Any] = []
    drop: Callable[[], object] = lambda: dropped.append(1)  # noqa: E731
    reader = Reader(drop)
    for _ in range(MOST_BEHIND + 5):
        reader.offer(b"x")
    assert (reader.ended, len(dropped)) == (True, 1)
    monkeypatch.setattr(channels, "MOST_BYTES", 10)
    large = Reader(drop)
    large.offer(b"x" * 100)
    assert not large.ended  # the first event, all there is, may be large
    large.offer(b"x")
    assert large.ended


def test_what_of_a_valve_can_t_be_read_is_in_the_page_s_log_once(
    station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    client = TestClient(application.application(replace(station.desk, warn=said.append)).asgi, base_url=OWN)
    assert client.get("/trend?valve=valve_1").status_code == 200
    assert said == []  # nothing is kept yet, which is no fault

    def failing(*_: object, **__: object) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(StateDatabase, "__init__", failing)
    for path in ("/trend?valve=valve_1", "/history.json", "/history.csv", "/sparks"):
        assert client.get(path).status_code == 200
    (line,) = said
    assert line.startswith("trends and journal of valve_1 can't be read, the page shows none")

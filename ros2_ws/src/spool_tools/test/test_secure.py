"""Keystores of `./spool secure`: certificates that verify, and permissions that say who may do what."""

from __future__ import annotations

import io
import shutil
import subprocess
from fnmatch import fnmatchcase
from pathlib import Path
from xml.etree import ElementTree as Xml

import pytest
from spool_core.opcua_folder import operators
from spool_tools.cli import main

ENCLAVES = (
    "host", "recorder", "viewer", "operator", "valve_1/estimator", "valve_1/monitor", "valve_1/simulator",
)  # fmt: skip
OPENSSL = shutil.which("openssl")


@pytest.fixture(name="keystore", scope="module")
def _keystore(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("secure") / "keystore"
    assert main(["secure", "--keystore", str(folder), "--valve", "valve_1", "--valve", "press/left"]) == 0
    return folder


def may(keystore: Path, enclave: str, what: str, topic: str) -> bool:
    """Return whether ``enclave`` may ``what`` (publish, subscribe) the DDS ``topic``."""
    grant = Xml.parse(keystore / "enclaves" / enclave / "permissions.xml").getroot().find(".//grant")
    assert grant is not None
    assert grant.findtext("default") == "DENY"
    listed = [one.text or "" for one in grant.findall(f"allow_rule/{what}/topics/topic")]
    return any(fnmatchcase(topic, pattern) for pattern in listed)


def test_only_operators_may_ask_a_monitor_for_something(keystore: Path) -> None:
    request, reply = (
        "rq/valve_1/monitor/acknowledge_alarmRequest",
        "rr/valve_1/monitor/acknowledge_alarmReply",
    )
    assert may(keystore, "operator", "publish", request)
    assert may(keystore, "operator", "subscribe", reply)
    assert may(keystore, "valve_1/monitor", "subscribe", request)
    assert may(keystore, "valve_1/monitor", "publish", reply)
    for enclave in ("viewer", "recorder", "valve_1/estimator", "valve_1/simulator", "press/left/monitor"):
        assert not may(keystore, enclave, "publish", request)


def test_recorder_and_viewer_hear_everything_and_send_no_data(keystore: Path) -> None:
    for enclave in ("recorder", "viewer"):
        for topic in ("rt/valve_1/acceleration", "rt/press/left/health", "rt/diagnostics"):
            assert may(keystore, enclave, "subscribe", topic)
        for topic in ("rt/valve_1/acceleration", "rt/valve_1/health", "rt/press/left/estimate"):
            assert not may(keystore, enclave, "publish", topic)


def test_only_those_who_judge_or_show_valves_hear_the_blocks_of_many(keystore: Path) -> None:
    """No node of a single valve does, and nobody but the measuring system sends them."""
    hear = [one for one in ENCLAVES if may(keystore, one, "subscribe", "rt/accelerations")]
    assert hear == ["host", "recorder", "viewer", "operator"]
    assert not any(may(keystore, one, "publish", "rt/accelerations") for one in ENCLAVES)


def test_a_node_sends_what_is_its_own_and_nothing_of_another_valve(keystore: Path) -> None:
    assert may(keystore, "valve_1/estimator", "publish", "rt/valve_1/estimate")
    assert not may(keystore, "valve_1/estimator", "publish", "rt/valve_1/acceleration")
    assert not may(keystore, "valve_1/estimator", "publish", "rt/press/left/estimate")
    assert may(keystore, "host", "publish", "rt/press/left/health")
    assert not may(keystore, "host", "publish", "rt/press/left/acceleration")


@pytest.mark.skipif(OPENSSL is None, reason="openssl is not installed")
def test_certificates_and_signatures_verify_with_openssl(keystore: Path) -> None:
    authority = keystore / "public" / "ca.cert.pem"
    verified = [OPENSSL, "verify", "-CAfile", authority]
    signed = [OPENSSL, "smime", "-verify", "-CAfile", authority, "-out", "/dev/null", "-in"]
    for enclave in (path.parent for path in (keystore / "enclaves").rglob("cert.pem")):
        files = (*verified, "cert.pem"), (*signed, "permissions.p7s"), (*signed, "governance.p7s")
        for *words, name in files:
            command = [str(word) for word in (*words, enclave / name)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr


def test_keys_are_their_owners_and_stay_when_a_valve_joins(keystore: Path, tmp_path: Path) -> None:
    store = Path(shutil.copytree(keystore, tmp_path / "keystore"))
    key = store / "enclaves" / "valve_1" / "monitor" / "key.pem"
    assert key.stat().st_mode & 0o077 == 0
    before = key.read_bytes()
    assert main(["secure", "--keystore", str(store), "--valve", "valve_1", "--valve", "valve_9"]) == 0
    assert key.read_bytes() == before
    assert may(store, "host", "publish", "rt/valve_9/health")


def test_a_folder_with_other_things_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "something").write_text("mine", "utf-8")
    assert main(["secure", "--keystore", str(tmp_path)]) == 2
    assert "holds other things" in capsys.readouterr().err


def test_a_folder_for_opc_ua_has_certificate_client_and_operator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "opcua"
    monkeypatch.setattr("sys.stdin", io.StringIO("a good secret\n"))
    assert main(["secure", "--opcua", str(folder), "--operator", "anna"]) == 0
    own = folder / "server.cert.pem"
    assert main(["secure", "--opcua", str(folder), "--trust", str(own)]) == 0
    assert operators(folder)["anna"].fits("a good secret")
    assert len(list((folder / "trusted").iterdir())) == 1
    assert "a good secret" not in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [[], ["--operator", "anna"], ["--trust", "client.der"]])
def test_secure_asks_for_a_folder(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["secure", *arguments]) == 2
    assert "--opcua" in capsys.readouterr().err

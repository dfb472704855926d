"""Live checks: what is read from the kernel's tables and from /diagnostics, and the messages about it."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from hypothesis import given
from hypothesis import strategies as st
from spool_tools.operations.machine_findings import (
    UdpCounts,
    buffer_finding,
    clock_finding,
    clock_state,
    participants,
    participants_finding,
    shared_memory_finding,
    udp_counts,
)
from spool_tools.operations.node_findings import node_findings

SNMP = """Ip: Forwarding DefaultTTL
Ip: 1 64
Udp: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors SndbufErrors
Udp: 5000 3 7 4000 7 0
"""


@given(domain=st.integers(0, 100), count=st.integers(0, 119))
def test_each_participant_of_a_domain_is_counted_by_its_ports(domain: int, count: int) -> None:
    ports = [7410 + 250 * domain + 2 * number + one for number in range(count) for one in (0, 1)]
    others = [7400 + 250 * domain, 7411 + 250 * (domain + 1), 53]
    lines = [f" 1: 00000000:{port:04X} 00000000:0000 07" for port in ports + others]
    assert participants(domain, "\n".join(["  sl  local_address rem_address", *lines])) == count


@pytest.mark.parametrize(("count", "level"), [(3, "ok"), (85, "warning"), (100, "problem")])
def test_many_participants_are_told_before_there_are_too_many(count: int, level: str) -> None:
    found = participants_finding(7, count)
    assert found.level == level
    assert f"{count} DDS participants of domain 7" in found.text


def test_datagrams_dropped_while_listening_are_a_problem_and_older_ones_are_not() -> None:
    now = udp_counts(SNMP)
    assert now == UdpCounts(5000, 7)
    assert buffer_finding(UdpCounts(4000, 7), now, "8388608").level == "ok"
    told = buffer_finding(UdpCounts(4000, 2), now, "8388608")
    assert told.level == "problem"
    assert told.text.startswith("5 datagrams")


def test_a_small_buffer_little_memory_and_a_free_clock_are_told_with_what_to_do() -> None:
    assert "net.core.rmem_max" in buffer_finding(UdpCounts(0, 0), UdpCounts(0, 0), "212992").text
    little = shared_memory_finding(10_000_000)
    assert little.level == "warning"
    assert little.text.startswith("shared memory: 10 MB free")
    assert shared_memory_finding(500_000_000).level == "ok"
    assert clock_finding(0x2001).level == "ok"
    assert "chrony" in clock_finding(0x40).text
    assert clock_state() >= -1


def status(name: str, level: bytes, message: str, **values: float) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=f"{value:.6g}") for key, value in values.items()]
    return DiagnosticStatus(name=name, level=level, message=message, values=pairs)


def told(*statuses: DiagnosticStatus) -> dict[str, str]:
    return {finding.text: finding.level for finding in node_findings({one.name: one for one in statuses})}


def test_a_host_near_a_full_core_and_a_valve_with_late_blocks_are_told() -> None:
    ok, warn = DiagnosticStatus.OK, DiagnosticStatus.WARN
    found = told(
        status("host: host", ok, "4 nodes", nodes=4, cpu_share=0.93, resident_B=2e8, jobs_waiting=3),
        status("host: valve_1", ok, "in time", block_age_s=0.01, blocks_late=0, blocks_lost=0),
        status("host: line/valve_2", warn, "7 blocks late", block_age_s=0.3, blocks_late=7, blocks_lost=2),
        status("valve_1/estimator: estimate", ok, "tracking"),
        status("valve_1/monitor: data", warn, "2 blocks lost"),
    )
    assert any("93 % of a core" in text and level == "warning" for text, level in found.items())
    assert any("300 ms old" in text and "7 late" in text and "2 lost" in text for text in found)
    assert found["line/valve_2: 7 blocks late"] == "warning"
    assert found["valve_1/monitor: data: 2 blocks lost"] == "warning"
    assert found["1 of 2 tasks of the nodes are as they should be"] == "ok"


def test_a_hundred_faulty_valves_are_ten_lines_and_a_count() -> None:
    warn = DiagnosticStatus.WARN
    found = told(*(status(f"valve_{number}/monitor: data", warn, "no blocks") for number in range(100)))
    assert "and 90 more of this kind" in found
    assert len(found) == 12


def test_silence_on_diagnostics_is_told() -> None:
    (text,) = told()
    assert "no node publishes" in text

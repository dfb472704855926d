"""Package of `./spool package` on a clean machine without network: from installation to purge under systemd.

The machine is this one's system on an overlay in namespaces, with all emptied that a clean one has not.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).parent
#: Version that the second package gets, whose content differs in one file.
NEWER = "1000.0"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("SPOOL_PACKAGE" not in os.environ, reason="SPOOL_PACKAGE names no package"),
]


@pytest.fixture(scope="module")
def facts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """What the trial found, by name; root only, since it makes namespaces and boots a system in them."""
    assert os.geteuid() == 0, "run it as root: it boots a system in separate namespaces"
    work = tmp_path_factory.mktemp("package")
    for name in ("dist", "io"):
        (work / name).mkdir()
    package = Path(os.environ["SPOOL_PACKAGE"]).resolve()
    shutil.copy(package, work / "dist" / "1.deb")
    newer(package, work / "content", work / "dist" / "2.deb")
    command = ["unshare", "--mount", "--pid", "--net", "--uts", "--ipc", "--fork"]
    subprocess.run([*command, "bash", str(HERE / "boot.sh"), str(work)], timeout=1500, check=False)
    print((work / "io" / "trial.log").read_text("utf-8"))
    lines = (work / "io" / "facts").read_text("utf-8").splitlines()
    yield {name: value.strip() for name, _, value in (line.partition(" ") for line in lines)}
    shutil.rmtree(work)


def newer(package: Path, content: Path, to: Path) -> None:
    """Repack a package as a later version with one file more."""
    subprocess.run(["dpkg-deb", "-R", str(package), str(content)], check=True)
    control = content / "DEBIAN" / "control"
    control.write_text(re.sub(r"(?m)^Version: .*$", f"Version: {NEWER}", control.read_text("utf-8")), "utf-8")
    (content / "opt" / "spool" / "NEWER").write_text("newer\n", "utf-8")
    subprocess.run(["dpkg-deb", "--root-owner-group", "-Zzstd", "-z1", "--build", content, to], check=True)
    shutil.rmtree(content)


def test_it_installs_without_network_and_its_services_start(facts: dict[str, str]) -> None:
    assert facts["links"] == "lo"
    assert facts["installed"] == "installed"
    assert facts["unit_complaints"] == "0"
    assert facts["started"] == "active"


def test_its_services_are_locked_in(facts: dict[str, str]) -> None:
    """Exposure of `systemd-analyze security`, 0 to 10: below 2 for both."""
    levels = [float(level) for level in re.findall(r"[\d.]+", facts["exposure"])]
    assert len(levels) == 2
    assert max(levels) < 2.0


def test_a_killed_recorder_and_a_host_that_hangs_are_started_again(facts: dict[str, str]) -> None:
    assert facts["recorder_killed"] == "1 active"
    assert facts["host_hung"] == "1 active"


def test_recordings_alarms_and_baselines_are_there_at_the_end(facts: dict[str, str]) -> None:
    assert facts["verified"] == "0"
    assert facts["alarms_of_valves"] == "2"
    assert int(facts["baselines"]) >= 2


def test_an_upgrade_restarts_running_services_with_the_new_version(facts: dict[str, str]) -> None:
    assert facts["upgraded_running"] == "active"
    assert facts["restarted_by_upgrade"] == "yes"
    assert facts["version_new"] == NEWER


def test_rollback_upgrade_remove_and_purge_keep_the_state_bit_for_bit(facts: dict[str, str]) -> None:
    assert facts["stopped"] == "inactive"
    assert int(facts["state_files"]) > 0
    assert facts["version_rolled_back"] == facts["version_old"] != facts["version_new"]
    assert [facts[step] for step in ("rollback", "upgrade", "remove", "purge")] == ["same"] * 4


def test_it_leaves_settings_until_purged_and_then_nothing(facts: dict[str, str]) -> None:
    assert facts["started_again"] == "active"
    assert facts["left_in_opt"] == ""
    assert "valves.yaml" in facts["settings_after_remove"]
    assert facts["left_after_purge"] == ""
    assert facts["end"] == "yes"

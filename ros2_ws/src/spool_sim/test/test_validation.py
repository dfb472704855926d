"""A file of settings is read, or refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from spool_core.errors import InputError
from spool_sim.valve import load_valve


@pytest.mark.parametrize("text", ["", "x", "- 1", "1: 2", "? [a]\n: 1", "id: [\n"])
def test_what_is_no_mapping_of_keys_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, "utf-8")
    with pytest.raises(InputError, match=r"a\.yaml: ") as caught:
        load_valve(path)
    assert "\n" not in str(caught.value)


def test_a_long_list_of_faults_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("id: " + "x" * 10_000 + "\n" + "".join(f"key_{n}: 1\n" for n in range(1000)), "utf-8")
    with pytest.raises(InputError, match=r"and 9\d\d more") as caught:
        load_valve(path)
    assert len(str(caught.value)) < 5000

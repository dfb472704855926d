"""A YAML file costs no more than its size, whatever it holds."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from spool_stream.errors import InputError
from spool_stream.files.yaml_file import LARGEST, YamlError, load_yaml, read_yaml

#: Each of 9 lists holds the one before nine times: 3.5e8 values in some 300 bytes.
BILLION_LAUGHS = 'a0: &a0 [x,x,x,x,x,x,x,x,x]\n' + "".join(
    f"a{n}: &a{n} [{','.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9)
)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (BILLION_LAUGHS, "line 2: aliases"),
        ("a: &a {<<: *a}", "aliases"),
        ("[" * 20_000, "nested deeper than 32"),
        ("- " * 20_000 + "x", "nested deeper than 32"),
        ("{a: " * 20_000, "nested deeper than 32"),
        ("- 1\n" * 60_000, "line 50000: it has more than 50000 values"),
        ("a: " + "x" * LARGEST, "more than 1000000 characters"),
        ("a: 2020-99-99", "a value can't be read"),
        ("a: !!int ''", "a value can't be read"),
        ("a: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
        ("a: 1\nb: {c: [{a: 1, a: 2}]}", r"key 'a' stands twice \(again in line 2\)"),
        ("a: [", r"not valid YAML in line \d"),
        ("\x00", "not valid YAML"),
    ],
)
def test_what_would_end_the_process_is_refused_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=reason) as caught:
        read_yaml(path, "valve")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400 + len(str(path))


@settings(max_examples=150, deadline=None)
@example("? [a]\n: 1")
@example("!!timestamp x")
@example("!!bool x")
@given(st.text(alphabet=st.sampled_from("ab01:-[]{}#&*!|>'\"%@,?<=. \n\t\x1b\x00é\ud800"), max_size=60))
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    try:
        load_yaml(text)
        refused = ""
    except YamlError as error:
        refused = str(error)
    assert "\n" not in refused
    assert len(refused) < 300

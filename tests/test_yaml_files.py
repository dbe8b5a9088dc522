"""YAML files: what was written is read to the last bit, and hostile files are refused at once."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from graspcascade.core import yaml_files as module
from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.machine import child_environment
from graspcascade.core.yaml_files import dump_yaml, load_yaml, yaml_files

BILLION_LAUGHS = "a: &a [x, x]\n" + "".join(
    f"{name}: &{name} [*{before}, *{before}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)

numbers = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**63), 2**63) | st.booleans() | st.none()
names = st.text(st.characters(exclude_categories=["C"]), max_size=12)
plain = st.recursive(
    numbers | names, lambda part: st.lists(part, max_size=4) | st.dictionaries(names, part, max_size=4), max_leaves=12
)


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "file.yaml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plain)
def test_plain_data_is_read_as_it_was_written(tmp_path: Path, data: object) -> None:
    path = tmp_path / "data.yaml"
    dump_yaml(path, {"data": data}, "two\nlines")
    assert load_yaml(path) == {"data": data}
    assert path.read_text(encoding="utf-8").startswith("# two\n# lines\n")


def test_equal_parts_are_written_in_full(tmp_path: Path) -> None:
    part = [1.0, 2.0]
    dump_yaml(tmp_path / "data.yaml", {"a": part, "b": part}, "")
    assert load_yaml(tmp_path / "data.yaml") == {"a": part, "b": part}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: &x [1]\nb: *x\n", r"YAML references \(& and \*\)"),
        ("a: &x 1\n", "YAML references"),
        ("&x a: 1\n", "YAML references"),
        (BILLION_LAUGHS, "YAML references"),
        ("&a [*a]", "YAML references"),
        ("base: {a: 1}\nb:\n  <<: {c: 2}\n", r"YAML merge key \(<<\)"),
        ("a: !!python/object/apply:os.system [echo]\n", "the YAML tag tag:yaml.org,2002:python/object/apply"),
        ('a: !!int ""\n', "the YAML tag tag:yaml.org,2002:int"),
        ("a: !!binary aGk=\n", "the YAML tag"),
        ("a: !mine 1\n", "the YAML tag !mine"),
        ("[" * 50_000 + "]" * 50_000, "nested deeper than 40"),
        ("a: " + "{b: " * 5_000 + "1" + "}" * 5_000, "nested deeper than 40"),
        ("\n".join(" " * depth + "a:" for depth in range(1_000)), "nested deeper than 40"),
        ("a: " + "1" * 200_000, "longer than 100000 characters"),
        ("a" * 200_000 + ": 1", "longer than 100000 characters|not a complete YAML document"),
        ("a: " + "1" * 5_000, "not a complete YAML document"),
        ("a: [1, 2", "not a complete YAML document"),
        ("a: 1\n---\nb: 2\n", "not a complete YAML document"),
        ("a: 2001-99-99\n", "not a complete YAML document"),
        ("a: 1\nb: 2\na: 3\n", "the key 'a' twice in one mapping"),
        ("a: {b: 1, b: 1}\n", "the key 'b' twice in one mapping"),
        ("? [a]\n: 1\n", "not a complete YAML document"),
        (b"a: \xff\xfe\n", "not a complete YAML document"),
        (b"\x00\x01\x02", "not a complete YAML document"),
    ],
)
def test_a_file_that_is_no_plain_data_is_refused_at_once_in_one_line(
    tmp_path: Path, text: str | bytes, says: str
) -> None:
    start = time.process_time()
    with pytest.raises(FileFormatError, match=says) as caught:
        load_yaml(written(tmp_path, text))
    assert time.process_time() - start < 2
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("text", ["'['*50000+']'*50000", "'{a: '*50000", "'- '*50000", "'[[1],'*30000", "'!!int \"\"'"])
def test_no_file_brings_the_interpreter_down(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, str(eval(text)))
    program = (
        "import sys; from pathlib import Path; from graspcascade.core.yaml_files import load_yaml\n"
        "from graspcascade.core.errors import FileFormatError\n"
        "try: load_yaml(Path(sys.argv[1]))\n"
        "except FileFormatError as error: print(error)"
    )
    command = [sys.executable, "-c", program, str(path)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, env=child_environment(), check=False)
    assert ended.returncode == 0, ended.stderr[-500:]
    assert len(ended.stdout.splitlines()) == 1


def test_a_string_that_looks_like_a_merge_key_or_reference_is_read_where_it_is_quoted(tmp_path: Path) -> None:
    assert load_yaml(written(tmp_path, 'a: "<<"\nb: "*x"\nc: "&x"\n')) == {"a": "<<", "b": "*x", "c": "&x"}


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MAX_BYTES", 1_000_000)
    with pytest.raises(FileFormatError, match="larger than 1 MB"):
        load_yaml(written(tmp_path, "a: 1\n" * 300_000))
    monkeypatch.setattr(module, "_MAX_NODES", 100)
    with pytest.raises(FileFormatError, match="more than 100 parts"):
        load_yaml(written(tmp_path, "- 1\n" * 200))


def test_a_file_that_is_absent_is_refused(tmp_path: Path) -> None:
    for absent in (tmp_path / "absent.yaml", tmp_path):
        with pytest.raises(InputError, match="there is no file"):
            load_yaml(absent)


def test_yaml_files_of_a_folder_are_listed_by_name(tmp_path: Path) -> None:
    for name in ("b.yaml", "a.YML", "c.json"):
        (tmp_path / name).touch()
    assert [path.name for path in yaml_files(tmp_path)] == ["a.YML", "b.yaml"]

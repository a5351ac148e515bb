"""Files as structs, and errors that name the file and the field."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec import Struct

from rce.errors import InvalidRequest
from rce.structfile import read


class Inner(Struct, forbid_unknown_fields=True):
    rate: float = 1.0
    source: Path = Path("default")


class Config(Struct, forbid_unknown_fields=True):
    name: str
    on: bool = False
    parts: list[Inner] = []
    by_key: dict[str, int] = {}


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    return tmp_path


def load(directory: Path, name: str, text: str) -> Config:
    path = directory / name
    path.write_text(text, encoding="utf-8")
    return read(path, Config)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("x.json", '{"name": "a", "on": true, "parts": [{"rate": 2.5}], "by_key": {"1": 2}}'),
        ("x.conf", '{"name": "a", "on": true, "parts": [{"rate": 2.5}], "by_key": {"1": 2}}'),
        ("x.yaml", "name: a\non: true\nparts:\n- rate: 2.5\nby_key:\n  1: 2\n"),
        ("x.yml", "name: a\n'on': yes\nparts: [{rate: 2.5}]\nby_key: {1: 2}\n"),
    ],
)
def test_name_of_the_file_chooses_json_or_yaml(directory: Path, name: str, text: str) -> None:
    assert load(directory, name, text) == Config("a", True, [Inner(2.5)], {"1": 2})


def test_yaml_merge_keys_work(directory: Path) -> None:
    text = "name: a\nparts:\n- &base {rate: 2}\n- <<: *base\n  source: /x\n"
    assert load(directory, "x.yaml", text).parts == [Inner(2), Inner(2, Path("/x"))]


def test_paths_may_begin_with_the_home_directory(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/ann")
    found = load(directory, "x.yaml", "name: a\nparts: [{source: ~/bag}, {source: bag}]\n")
    assert [part.source for part in found.parts] == [Path("/home/ann/bag"), Path("bag")]


@pytest.mark.parametrize(
    ("text", "field", "reason"),
    [
        ("{}", "", "missing required field `name`"),
        ("name: 5", "name", "Expected `str`, got `int`"),
        ("name: a\ncolour: red", "", "unknown field `colour`"),
        ("nmae: a", "", "unknown field `nmae` (nmae: did you mean name?)"),
        ("name: a\nparts: [{rat: 1}]", "parts[0]", "unknown field `rat` (parts[0].rat: did you mean rate?)"),
        ("name: a\nparts: [{}, {rate: fast}]", "parts[1].rate", "Expected `float`, got `str`"),
        ("name: a\nparts: [{source: 5}]", "parts[0].source", "Expected `str`, got `int`"),
        ("", "", "Expected `object`, got `null`"),
        ("- 1", "", "Expected `object`, got `array`"),
    ],
)
def test_wrong_content_names_the_file_and_the_field(directory: Path, text: str, field: str, reason: str) -> None:
    with pytest.raises(InvalidRequest) as caught:
        load(directory, "x.yaml", text)
    assert caught.value.field == field
    assert reason in str(caught.value)
    assert str(caught.value).startswith(f"{directory}/x.yaml: {field}{': ' if field else ''}")


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("x.json", b"name: a", r"is not JSON \(a YAML file must be named \.yaml\)"),
        ("x.json", b"[" * 100_000, r"x\.json"),
        ("x.yaml", b"name: [", "while parsing"),
        ("x.yaml", b"? [a, b]\n: c", "unhashable key"),
        ("x.yaml", b"name: !!python/name:os.system", "could not determine a constructor"),
        ("x.yaml", b"name: \xff", "utf-8"),
    ],
)
def test_malformed_file_is_refused(directory: Path, name: str, content: bytes, reason: str) -> None:
    (directory / name).write_bytes(content)
    with pytest.raises(InvalidRequest, match=reason):
        read(directory / name, Config)


def test_missing_file_is_refused_with_its_name(directory: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"missing\.yaml"):
        read(directory / "missing.yaml", Config)


def test_type_that_files_cannot_hold_is_a_programming_error(directory: Path) -> None:
    class Unusable(Struct):
        part: complex

    (directory / "x.json").write_text('{"part": 1}')
    with pytest.raises(NotImplementedError, match="complex"):
        read(directory / "x.json", Unusable)

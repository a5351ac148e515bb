"""The format of robot files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml
from msgspec import Struct

from rce.client.robotfile import credentials
from rce.client.robotformat import (
    ConnectionEntry,
    ContainerEntry,
    InterfaceEntry,
    NodeEntry,
    ParameterEntry,
    RobotFile,
    read,
    schema,
)
from rce.errors import InvalidRequest
from tests.support.paths import ROOT
from tests.support.robot_files import robot_file

TOPIC = {"eTag": "a", "iTag": "i", "iType": "PublisherConverter", "iCls": "std_msgs/String"}


@pytest.mark.parametrize("suffix", [".cfg", ".json", ".yaml", ".yml"])
def test_json_and_yaml_are_equivalent(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"robot{suffix}"
    path.write_text(yaml.safe_dump(robot_file()) if "y" in suffix else json.dumps(robot_file()))
    file = read(path)
    assert isinstance(file, RobotFile)
    assert file.containers[1].group == "net"
    assert file.parameters[0].value == ["one", 2, "three", "true"]
    assert file.interfaces[0].addr == "/req"


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"url": None}, "url: Expected `str`"),
        ({"nodes": [{"cTag": "c1", "nTag": "n", "exe": "x"}]}, r"nodes\[0\]: .*`pkg`"),
        ({"interfaces": [{"eTag": "a", "iTag": "i", "iType": "Publisher", "iCls": "a/B"}]}, r"interfaces\[0\].iType"),
        ({"parameters": [{"cTag": "c", "name": "x", "value": None}]}, r"parameters\[0\].value"),
        ({"connections": [{"tagA": "a/x", "tagB": "a/y", "tagC": ""}]}, "unknown field `tagC`"),
        ({"containers": [{"cTag": "c", "io": {"reed": 3}}]}, r"containers\[0\].io: .*`reed`"),
        ({"interfaces": [TOPIC | {"qos": {"dept": 5}}]}, r"interfaces\[0\].qos: .*`dept`"),
        ({"interfaces": [TOPIC | {"delivery": {"prio": "high"}}]}, r"interfaces\[0\].delivery: .*`prio`"),
        ({"interfaces": [TOPIC | {"delivery": {"decimate": {"stop": 2}}}]}, r"delivery.decimate: .*`stop`"),
    ],
)
def test_error_names_file_and_place(tmp_path: Path, change: dict[str, Any], where: str) -> None:
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(robot_file() | change))
    with pytest.raises(InvalidRequest, match=f"robot.json: .*{where}"):
        read(path)


@pytest.mark.parametrize(
    ("name", "text"), [("a.json", '{"url": \n nonsense}'), ("a.yaml", "url:\n\t- x: ["), ("b", "")]
)
def test_syntax_error_names_the_line(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InvalidRequest, match=rf"(?s){name}.*line \d"):
        read(path)


def test_error_names_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"nothing\.json"):
        read(tmp_path / "nothing.json")


def test_unknown_key_at_the_top_is_ignored_with_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(robot_file() | {"conections": []}))
    assert read(path).robotID == "a"
    assert "ignored unknown keys: conections" in caplog.text


def test_schema_in_the_documentation_is_up_to_date() -> None:
    written = json.loads((ROOT / "docs" / "robot-file.schema.json").read_text())
    assert written == schema(), "run python -m rce.client.robotformat > docs/robot-file.schema.json"


@pytest.mark.parametrize(
    "kind", [RobotFile, ContainerEntry, ParameterEntry, NodeEntry, InterfaceEntry, ConnectionEntry]
)
def test_every_field_is_documented(kind: type[Struct]) -> None:
    page = (ROOT / "docs" / "robot-file.md").read_text()
    missing = [field.encode_name for field in msgspec.structs.fields(kind) if f"`{field.encode_name}`" not in page]
    assert not missing


def test_wrong_choice_is_answered_with_the_values(tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    content = {"url": "http://h/", "userID": "u", "robotID": "r", "containers": [{"cTag": "c", "restart": "sometimes"}]}
    path.write_text(json.dumps(content))
    with pytest.raises(InvalidRequest, match=r"containers\[0\]\.restart: .*'sometimes': write 'always' or 'no'"):
        read(path)


@pytest.mark.parametrize(
    ("given", "environment", "expected"),
    [
        ({"key": "rce_k"}, {"RCE_KEY": "rce_other"}, (None, "rce_k")),
        ({"password": "p"}, {"RCE_KEY": "rce_other"}, ("p", None)),
        ({}, {"RCE_KEY": "rce_other", "RCE_PASSWORD": "x"}, (None, "rce_other")),
        ({}, {"RCE_PASSWORD": "x"}, ("x", None)),
        ({}, {}, None),
    ],
)
def test_secrets_come_from_the_environment_unless_the_file_has_them(
    monkeypatch: pytest.MonkeyPatch,
    given: dict[str, str],
    environment: dict[str, str],
    expected: tuple[str | None, str | None] | None,
) -> None:
    for name in ("RCE_KEY", "RCE_PASSWORD"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    file = RobotFile("http://h/", "u", "r", **given)
    if expected is None:
        with pytest.raises(InvalidRequest, match="RCE_KEY or RCE_PASSWORD"):
            credentials(Path("robot.json"), file)
    else:
        assert credentials(Path("robot.json"), file) == expected

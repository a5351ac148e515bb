"""Configuration file of a bridge."""

from __future__ import annotations

from pathlib import Path

import pytest

from endpoints.bridge.config import BuildMap, Record, read
from rce.errors import InvalidRequest
from tests.support.paths import ROOT

HEAD = "{url: 'http://cloud:9000/', user: u, robot: r, environment: {tag: e}"


def config(tmp_path: Path, rest: str) -> Path:
    path = tmp_path / "bridge.yaml"
    path.write_text(f"{HEAD}{', ' if rest else ''}{rest}}}")
    return path


def test_credential_can_come_from_environment_variables(tmp_path: Path) -> None:
    assert read(config(tmp_path, ""), {"RCE_KEY": "k", "RCE_PASSWORD": "p"}).key == "k"
    assert read(config(tmp_path, ""), {"RCE_PASSWORD": "p"}).password == "p"
    assert read(config(tmp_path, "key: own"), {"RCE_PASSWORD": "p"}).password is None


def test_requests_have_ids(tmp_path: Path) -> None:
    actions = (
        "rec: {action: record, topics: {/scan: sensor_msgs/LaserScan}, directory: ~/bags}, map: {action: build_map}"
    )
    requests = read(config(tmp_path, f"key: k, requests: {{{actions}}}")).requests
    assert requests == {
        "rec": Record({"/scan": "sensor_msgs/LaserScan"}, Path("~/bags").expanduser()),
        "map": BuildMap(),
    }


@pytest.mark.parametrize(
    ("rest", "where"),
    [
        ("", "give either key or password"),
        ("key: k, password: p", "give either key or password"),
        ("key: k, sned: {}", "unknown field `sned`"),
        ("key: k, send: {topics: [{topic: /a}]}", "send.topics"),
        ("key: k, send: {topics: [{topic: /a, type: a/B, rate: -1}]}", "rate"),
        ("key: k, send: {topics: [{topic: /a, type: a/B, qos: {history: keep_all}}]}", r"send.topics\[0\].qos"),
        ("key: k, receive: {topics: [{topic: /a, type: a/B, format: png}]}", r"receive.topics\[0\].format"),
        ("key: k, receive: {topics: [{topic: /a, type: a/B, offline: store}]}", r"receive.topics\[0\].offline"),
        ("key: k, send: {topics: [{topic: /a, type: a/B, offline: keep}]}", "offline"),
        ("key: k, send: {topics: [{topic: /a, type: a/B, store: f}]}", r"send.topics\[0\].store needs offline: store"),
        ("key: k, send: {tf: {frames: []}}", "send.tf.frames"),
        ("key: k, requests: {x: {action: dance}}", "dance"),
    ],
)
def test_error_names_file_and_position(tmp_path: Path, rest: str, where: str) -> None:
    with pytest.raises(InvalidRequest, match=where) as caught:
        read(config(tmp_path, rest), {})
    assert str(tmp_path / "bridge.yaml") in str(caught.value)


def test_example_of_documentation_is_valid(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "bridge.md").read_text()
    file = tmp_path / "bridge.yaml"
    file.write_text(text.partition("```yaml\n")[2].partition("```")[0])
    assert list(read(file, {"RCE_KEY": "k"}).requests) == ["on", "off", "record", "enough", "map"]

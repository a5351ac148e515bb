"""Fast DDS profile of an environment, alone or in a network group."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from endpoints.environment import process_environment
from endpoints.environment.settings import Settings

INTERFACES = "profiles/transport_descriptors/transport_descriptor/interfaceWhiteList/address"
DDS = "{http://www.eprosima.com}"


def profile(directory: Path, monkeypatch: pytest.MonkeyPatch, address: str = "", peers: list[str] | None = None) -> str:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("FASTDDS_DEFAULT_PROFILES_FILE", "")
    monkeypatch.setattr(sys, "path", list(sys.path))
    settings = Settings("ann/map", "0" * 32, "token", "tcp:127.0.0.1:1", directory, address=address, peers=peers or [])
    process_environment.prepare(settings)
    assert process_environment.node_variables(settings).get("RCE_GROUP_IP", "") == address
    return Path(os.environ["FASTDDS_DEFAULT_PROFILES_FILE"]).read_text()


def texts(profile: str, path: str) -> list[str | None]:
    return [
        each.text for each in ElementTree.fromstring(profile).findall("/".join(DDS + each for each in path.split("/")))
    ]


def test_environment_alone_uses_loopback_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = profile(tmp_path, monkeypatch)
    assert texts(found, "profiles/participant/rtps/userTransports/transport_id") == ["shared_memory", "network"]
    assert texts(found, INTERFACES) == ["127.0.0.1"]
    assert "initialPeersList" not in found


def test_environment_in_group_uses_network_and_members_of_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = profile(tmp_path, monkeypatch, "10.128.0.3", ["10.128.0.2"])
    assert texts(found, "profiles/participant/rtps/userTransports/transport_id") == ["shared_memory", "network"]
    assert texts(found, INTERFACES) == ["10.128.0.3", "127.0.0.1"]
    peers = "profiles/participant/rtps/builtin/initialPeersList/locator/udpv4/address"
    assert texts(found, peers) == ["239.255.0.1", "127.0.0.1", "10.128.0.3", "10.128.0.2"]

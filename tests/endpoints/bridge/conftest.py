"""The robot's own ROS as a fake, and a configuration."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from endpoints.bridge.config import BridgeConfig, read
from tests.support.fake_platform import PASSWORD

if TYPE_CHECKING:
    from tests.support.endpoints.fake_local_ros import FakeLocalRos

MakeConfig = Callable[..., BridgeConfig]


@pytest.fixture
def local() -> FakeLocalRos:
    pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")
    from tests.support.endpoints.fake_local_ros import FakeLocalRos

    return FakeLocalRos()


@pytest.fixture
def make_config(tmp_path: Path) -> MakeConfig:
    """Return the configuration of a bridge for the environment `sky`, with the given keys."""

    def make(**keys: Any) -> BridgeConfig:
        file = tmp_path / "bridge.json"
        whole = {
            "url": "http://127.0.0.1:1/",
            "user": "testUser",
            "robot": "a",
            "password": PASSWORD,
            "environment": {"tag": "sky"},
        }
        file.write_text(json.dumps(whole | keys))
        return read(file, {})

    return make

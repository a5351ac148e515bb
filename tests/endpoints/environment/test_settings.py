"""Settings of an Environment endpoint, as an engine gives them by variables."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from endpoints.environment.settings import Settings

GIVEN = {"name": "ann/map", "run": "0" * 32, "token": "t", "master": "tcp:127.0.0.1:1", "data_dir": Path("/data")}


def read(**more: object) -> Settings:
    return msgspec.convert(GIVEN | more, Settings)


@pytest.mark.parametrize("name", ["map", "ann/", "/map", "ann/map/more", ""])
def test_name_must_be_user_and_container_tag(name: str) -> None:
    with pytest.raises(msgspec.ValidationError, match="name"):
        read(name=name)


def test_valid_settings_are_accepted() -> None:
    assert read(shared_memory=4096).name == "ann/map"


@pytest.mark.parametrize("size", [0, 4097])
def test_shared_memory_is_limited(size: int) -> None:
    with pytest.raises(msgspec.ValidationError, match="shared_memory"):
        read(shared_memory=size)

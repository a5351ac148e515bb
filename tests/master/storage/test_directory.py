"""Choice of the data directory of a Master."""

from __future__ import annotations

from pathlib import Path

import pytest

from master.storage.directory import existing_master_directory
from rce.errors import NotFound


@pytest.mark.parametrize("given", [".", "master"])
def test_directory_of_a_platform_stands_for_that_of_its_master(tmp_path: Path, given: str) -> None:
    (tmp_path / "master").mkdir()
    (tmp_path / "master" / "master.db").touch()
    assert existing_master_directory(tmp_path / given) == tmp_path / "master"


@pytest.mark.parametrize(("given", "reason"), [("none", "no directory"), (".", "no database")])
def test_directory_without_a_database_is_refused_and_left_as_it_is(tmp_path: Path, given: str, reason: str) -> None:
    with pytest.raises(NotFound, match=reason):
        existing_master_directory(tmp_path / given)
    assert not [*tmp_path.iterdir()]

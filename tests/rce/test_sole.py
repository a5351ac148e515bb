"""A directory for one process at a time."""

from pathlib import Path

import pytest

from rce.errors import AlreadyExists
from rce.sole import sole_user


def test_a_second_user_is_refused_until_the_first_has_gone(tmp_path: Path) -> None:
    directory = tmp_path / "a" / "b"
    with (
        sole_user(directory, "Master"),
        pytest.raises(AlreadyExists, match=r"another Master works in .*/a/b: end it"),
        sole_user(directory, "Master"),
    ):
        pass
    with sole_user(directory, "Master"), sole_user(directory, "task set"):
        pass

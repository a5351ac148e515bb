"""Seal of secrets: what it closes only its key opens."""

from __future__ import annotations

from pathlib import Path

import pytest

from master.access.sealing import Seal
from rce.errors import InvalidRequest, NotFound


def test_sealed_text_is_opened_with_the_key_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "key"
    sealed = Seal(file).close("pässword")
    assert "ssword" not in sealed
    assert Seal(file).open(sealed) == "pässword"
    assert file.stat().st_mode & 0o777 == 0o600
    for other in (Seal(), Seal(tmp_path / "another")):
        with pytest.raises(NotFound, match="another key"):
            other.open(sealed)


def test_damaged_key_is_named(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_text("x")
    with pytest.raises(InvalidRequest, match=str(file)):
        Seal(file).close("text")

"""Network namespaces."""

from __future__ import annotations

import pytest

from rce.bench.network import namespaces
from rce.bench.network.namespaces import entered, ip
from rce.errors import Unavailable


def test_missing_program_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(namespaces, "IP", "no-such-program")
    with pytest.raises(Unavailable, match="install the package iproute2"):
        ip("link")


def test_failed_command_has_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(namespaces, "IP", "false")
    with pytest.raises(Unavailable, match="false link"):
        ip("link")


def test_unknown_namespace_is_an_error() -> None:
    with pytest.raises(FileNotFoundError), entered("rce-no-such-namespace"):
        pass

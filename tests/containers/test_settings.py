import os
from pathlib import Path

import pytest

from containers.settings import Settings, check_isolation, is_local
from rce.errors import InvalidRequest


@pytest.mark.parametrize(
    ("description", "local"),
    [
        ("tcp:127.0.0.1:8080", True),
        ("tcp:host=127.0.0.53:port=8080", True),
        ("tcp:localhost:8080", True),
        (r"tcp:\:\:1:8080", True),
        ("tls:localhost:8080:trustRoots=/etc/ca", True),
        ("unix:/run/rce.sock", True),
        ("tcp:10.0.0.1:8080", False),
        ("tcp:localhost.example.org:8080", False),
        ("tls:master.example.org:8080", False),
        ("tcp:port=8080:host=127.0.0.1", False),  # not recognized, so not certainly local
        ("nonsense", False),
    ],
)
def test_local_addresses_are_recognized(description: str, local: bool) -> None:
    assert is_local(description) == local


def test_process_engine_serves_a_local_master_only() -> None:
    far = "tcp:10.0.0.1:8080"
    check_isolation(Settings(Path("d"), allow_root=True))
    check_isolation(Settings(Path("d"), master=far, allow_unisolated=True, allow_root=True))
    with pytest.raises(InvalidRequest, match=r"10\.0\.0\.1.*--allow-unisolated"):
        check_isolation(Settings(Path("d"), master=far, allow_root=True))


def test_process_engine_runs_as_root_only_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    check_isolation(Settings(Path("d"), engine="docker"))
    with pytest.raises(InvalidRequest, match=r"as root.*--allow-root"):
        check_isolation(Settings(Path("d")))
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    check_isolation(Settings(Path("d")))

"""Identity of the machine."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from rce.process.host import host_identity


def test_processes_of_one_machine_agree() -> None:
    program = "from rce.process.host import host_identity; print(host_identity())"
    other = subprocess.run([sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == host_identity()
    assert len(bytes.fromhex(host_identity())) == 16


def test_other_kernel_has_another_identity(monkeypatch: pytest.MonkeyPatch) -> None:
    before = host_identity()
    monkeypatch.setattr(Path, "read_text", lambda self: "another boot id\n")
    assert host_identity() != before


def test_other_root_directory_has_another_identity(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A container has the kernel of its host, but cannot reach its UNIX sockets."""
    before = host_identity()
    inside = tmp_path.stat()
    monkeypatch.setattr(Path, "stat", lambda self: inside)
    assert host_identity() != before

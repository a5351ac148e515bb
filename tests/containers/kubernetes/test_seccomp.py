"""The profile of system calls in kubelet's directory."""

from __future__ import annotations

import json
from pathlib import Path

from containers.kubernetes.seccomp import PROFILE, install


def test_profile_is_installed_once(tmp_path: Path) -> None:
    install(tmp_path)
    file = tmp_path / PROFILE
    assert json.loads(file.read_text())["defaultAction"] == "SCMP_ACT_ERRNO"
    before = file.stat().st_mtime_ns
    install(tmp_path)
    assert file.stat().st_mtime_ns == before
    assert [each.name for each in file.parent.iterdir()] == [file.name]

"""Names of releases, and the link to the current one."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from provisioning import release
from provisioning.system import System
from tests.support.paths import ROOT


def test_name_depends_on_content_and_extras(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in release.FILES:
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "rce").mkdir()
    (tmp_path / "rce" / "a.py").write_text("a = 1")
    monkeypatch.setattr(release, "ROOT", tmp_path)
    first = release.release_name(["server"])
    assert first.startswith("0.1.0-")
    assert release.release_name(["server"]) == first
    assert release.release_name(["server", "docker"]) != first
    (tmp_path / "rce" / "a.py").write_text("a = 2")
    assert release.release_name(["server"]) != first


def test_switch_removes_old_releases(tmp_path: Path) -> None:
    releases = tmp_path / "opt/rce/releases"
    link = tmp_path / "opt/rce/current"
    for number in range(4):
        (releases / f"r{number}").mkdir(parents=True)
        release._switch(link, f"releases/r{number}")
    assert release.installed_release(System(tmp_path)) == "r3"
    assert len(list(releases.iterdir())) == release.KEPT
    assert (releases / "r2").exists()


def test_master_with_postgresql_needs_its_client() -> None:
    assert "postgresql" in release.required_extras(["master"], "docker", "postgresql+psycopg://x")
    assert "postgresql" not in release.required_extras(["master"], "docker")
    assert "postgresql" not in release.required_extras(["robot"], "docker", "postgresql+psycopg://x")

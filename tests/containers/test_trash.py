"""Removal of trees with any contents: it makes nobody wait and never fails."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from containers import trash as module
from containers.trash import Trash
from tests.support.containers.trees import cleared, names, nest


@pytest.fixture
def trash(tmp_path: Path) -> Trash:
    return Trash(tmp_path / "trash")


async def test_deep_tree_is_removed(trash: Trash, tmp_path: Path) -> None:
    trash.open()
    with cleared(tmp_path):
        nest(tmp_path / "deep", 3000)
        removal = trash.take(tmp_path / "deep")
        assert names(tmp_path) == ["trash"]
        assert removal is not None
        await removal
        assert names(tmp_path / "trash") == []


async def test_files_sockets_and_links_are_removed_but_not_what_links_lead_to(trash: Trash, tmp_path: Path) -> None:
    trash.open()
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "kept")
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "file").touch()
    for name in ("file", "link", "missing"):
        await trash.discard(tmp_path / name)
    assert names(tmp_path) == ["kept", "trash"]
    assert (tmp_path / "kept" / "file").exists()


async def test_slow_removal_makes_nobody_wait(trash: Trash, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WAIT", 0.01)
    trash.open()
    (tmp_path / "tree").mkdir()
    async with trash._lock:  # as while another tree is removed
        await trash.discard(tmp_path / "tree")
        assert not (tmp_path / "tree").exists()
        assert len(names(tmp_path / "trash")) == 1
    await asyncio.gather(*trash._tasks)
    assert names(tmp_path / "trash") == []


async def test_interrupted_removal_is_continued_by_the_next_process(trash: Trash, tmp_path: Path) -> None:
    trash.open()
    (tmp_path / "tree").mkdir()
    async with trash._lock:
        trash.take(tmp_path / "tree")
        await trash.close()
    again = Trash(tmp_path / "trash")
    again.open()
    await asyncio.gather(*again._tasks)
    assert names(tmp_path / "trash") == []


async def test_what_cannot_be_moved_stays_without_an_error(trash: Trash, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "trash").touch()  # no directory
    await trash.discard(tmp_path / "file")
    assert (tmp_path / "file").exists()

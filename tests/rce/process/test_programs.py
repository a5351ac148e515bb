"""Server programs by their entry points."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec

import pytest

from rce.errors import NotFound
from rce.process import programs


def test_command_starts_the_module_of_the_entry_point() -> None:
    assert programs.command("master") == [sys.executable, "-P", "-m", "master"]
    assert programs.command("hollow-machine") == [sys.executable, "-P", "-m", "containers.hollow"]


def test_command_of_every_installed_program_is_a_module() -> None:
    for name in programs.installed_programs():
        assert find_spec(programs.command(name)[-1]) is not None


def test_unknown_program_is_not_found() -> None:
    with pytest.raises(NotFound, match="the program nothing is not installed"):
        programs.command("nothing")


@pytest.mark.parametrize(
    ("name", "library", "extras"), [("master", "twisted", "server"), ("image", "docker", "server,docker")]
)
def test_missing_library_is_reported_with_the_extra_that_has_it(
    monkeypatch: pytest.MonkeyPatch, name: str, library: str, extras: str
) -> None:
    monkeypatch.setattr(programs, "find_spec", lambda wanted: None if wanted == library else object())
    with pytest.raises(NotFound, match=rf"pip install '\.\[{extras}\]'"):
        programs.command(name)


def test_program_is_installed_with_its_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "find_spec", lambda wanted: object() if wanted == "aiohttp" else None)
    assert programs.installed("map-service", "aiohttp")
    assert not programs.installed("map-service", "aiohttp", "lxml")
    assert not programs.installed("nothing")


def test_names_of_installed_programs_are_sorted() -> None:
    names = programs.installed_programs()
    assert {"master", "robot", "environment", "container", "map-service"} <= set(names)
    assert names == sorted(names)


def test_exec_replaces_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    executed: list[tuple[str, list[str]]] = []
    monkeypatch.setattr(os, "execv", lambda path, words: executed.append((path, words)))
    programs.exec_program("master", ["--help"])
    assert executed == [(sys.executable, [sys.executable, "-P", "-m", "master", "--help"])]

"""Viewers of one camera beside a control loop."""

from __future__ import annotations

from contextlib import AsyncExitStack
from pathlib import Path
from types import ModuleType

import pytest

from rce.bench import viewers
from rce.bench.camera_program import Place
from rce.bench.viewer_program import Seen, Task
from rce.bench.viewers import Phase, as_text, crowd, film
from rce.errors import InvalidRequest
from tests.support.bench import fake_place

PLACE = Place("http://127.0.0.1:1/", "brain", "camera", "ann", "secret")


async def test_place_without_an_address_is_refused() -> None:
    async with AsyncExitStack() as stack:
        place, *_ = fake_place(stack)
        with pytest.raises(InvalidRequest, match="address of the platform"):
            await viewers.measure(place._replace(address=None), Task(1), 1)


async def test_camera_says_how_many_images_it_has_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = "import sys\nfor count, _ in enumerate(sys.stdin):\n    print(30 * count, flush=True)\n"
    stand_in(script, tmp_path, monkeypatch, viewers.camera_program)
    async with film(PLACE) as camera:
        assert [await camera.sent(), await camera.sent()] == [30, 60]


async def test_camera_that_cannot_connect_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in("import sys\nsys.exit('cannot connect')\n", tmp_path, monkeypatch, viewers.camera_program)
    with pytest.raises(InvalidRequest, match="camera could not connect"):
        async with film(PLACE):
            pass


READY = "import sys\nsys.stdin.readline()\nprint('ready', flush=True)\nsys.stdin.read()\nprint('{\"messages\":1}')\n"


def stand_in(script: str, directory: Path, monkeypatch: pytest.MonkeyPatch, program: ModuleType) -> None:
    """Let a script take the place of a program."""
    (directory / "stand_in.py").write_text(script)
    monkeypatch.setenv("PYTHONPATH", str(directory))
    monkeypatch.setattr(program, "__name__", "stand_in")


async def test_viewers_say_in_the_end_what_they_have_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(READY, tmp_path, monkeypatch, viewers.viewer_program)
    async with crowd(Task(1)) as seen:
        pass
    assert await seen == Seen(messages=1)


async def test_viewers_that_cannot_connect_are_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in("import sys\nsys.exit('cannot connect')\n", tmp_path, monkeypatch, viewers.viewer_program)
    with pytest.raises(InvalidRequest, match="could not connect"):
        async with crowd(Task(1)):
            pass


def test_table_says_how_often_images_were_encoded() -> None:
    seen = Seen(messages=100, bytes=5_000_000, encoded=20)
    table = as_text([Phase("quiet", [0.001, 0.002]), Phase("and 5 viewers", [0.002, 0.003], 21, seen)])
    assert "1.50" in table
    assert "21 images sent; encoded 20 times, received 100 times" in table

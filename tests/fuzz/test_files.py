"""Files of users: pictures, and recordings (CARMEN, ROS 1 and ROS 2 bags)."""

from __future__ import annotations

import contextlib
import functools
import itertools
import time
from pathlib import Path

import pytest

from converters.images import Picture, read_picture, write_picture
from converters.scalars import FieldError
from rce.errors import RceError
from rce.mapping.files.recordings import BAG_SUFFIXES, open_recording
from tests.support.fuzz.mutation import Mutator
from tests.support.recordings import WRITERS, carmen, flaser

pytestmark = pytest.mark.slow

SLOW = 20.0  # seconds for one case, on a busy machine too
SCANS = 20  # of a recording, as many as the map service reads before it accepts one


@pytest.mark.share(0.09)
@pytest.mark.parametrize("format", ["png", "jpeg"])
def test_each_picture_is_decoded_or_refused(cases: int, seed: str, format: str) -> None:
    mutator = Mutator(f"{seed} {format}")
    pixels = bytes(range(256)) * 3
    pictures = [write_picture(Picture(16, 16, "rgb8", 0, 48, pixels), format)]  # type: ignore[arg-type]
    pictures += [write_picture(Picture(16, 16, "mono8", 0, 16, pixels[:256], (1, 2), "f"), format)]  # type: ignore[arg-type]
    for number in range(cases):
        began = time.perf_counter()
        data = mutator.damage(mutator.choose(pictures))
        with contextlib.suppress(FieldError):
            read_picture(data)
        assert time.perf_counter() - began < SLOW, f"case {number}: {data!r}"


def log(path: Path) -> Path:
    lines = [flaser(float(stamp), x=stamp / 10) for stamp in range(5)]
    return carmen(
        path / "a.log", "# comment\nPARAM robot_width 0.5\n" + "".join(lines) + "ODOM 1 2 3 0 0 0 9.0 h 0.1\n"
    )


def compressed(path: Path) -> Path:
    return carmen(path / "a.log.gz", log(path).read_text())


def bag(kind: str, path: Path) -> Path:
    made = WRITERS[kind](path)
    return made if made.is_file() else next(each for each in made.iterdir() if each.suffix in BAG_SUFFIXES)


MAKERS = {"log": log, "gzip": compressed} | {kind: functools.partial(bag, kind) for kind in WRITERS}


@pytest.mark.share(0.002)  # each opening of a bag takes some 10 ms
@pytest.mark.parametrize("kind", MAKERS)
def test_each_recording_is_read_or_refused(tmp_path: Path, cases: int, seed: str, kind: str) -> None:
    mutator = Mutator(f"{seed} {kind}")
    path = MAKERS[kind](tmp_path)
    good = path.read_bytes()
    for number in range(cases):
        began = time.perf_counter()
        path.write_bytes(mutator.damage(good))
        try:
            list(itertools.islice(open_recording(path), SCANS))
        except RceError:
            pass
        except Exception as error:
            error.add_note(f"case {number}")
            raise
        assert time.perf_counter() - began < SLOW, f"case {number}"

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from rce.bench.video import as_text, measure, read
from rce.errors import InvalidRequest
from tests.support.pictures import color, depth


def recorded(directory: Path) -> Path:
    for number in range(3):
        cv2.imwrite(str(directory / f"frame-{number:06d}.color.png"), color(number)[:, :, ::-1])
        cv2.imwrite(str(directory / f"frame-{number:06d}.depth.png"), depth(number))
    return directory


def test_images_are_read_as_they_were_recorded(tmp_path: Path) -> None:
    colors, depths = read(recorded(tmp_path), 2)
    assert len(colors) == len(depths) == 2
    assert (colors[1] == color(1)).all()
    assert (depths[1] == depth(1)).all()


def test_every_format_is_in_the_table_with_what_it_saves(tmp_path: Path) -> None:
    figures = list(measure(*read(recorded(tmp_path), 3)))
    assert [each.format for each in figures] == ["raw", "h264", "av1", "vp9", "raw", "palette", "ffv1", "png"]
    assert all(each.delay == 0 for each in figures)
    assert [each.exact for each in figures] == [True, False, False, False, True, True, True, True]
    assert all(each.saved > 0.5 for each in figures if each.format != "raw")
    assert len(as_text(figures).splitlines()) == 9


def test_directory_without_pairs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"no pairs of NAME\.color\.jpg"):
        read(tmp_path, 3)

"""Tables and texts in the width of a terminal."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rce.cli.layout import fit, plain, printable, text_width, wrap

NAMES = ("NAME", "TEXT")


@pytest.mark.parametrize(
    ("text", "width", "lines"),
    [
        ("", 5, [""]),
        ("one two", 7, ["one two"]),
        ("one two", 6, ["one", "two"]),
        ("one two", 3, ["one", "two"]),
        ("2030-01-31 08:00:00", 12, ["2030-01-31", "08:00:00"]),
        ("uses 1.5 GiB", 9, ["uses", "1.5 GiB"]),
        ("sensor_msgs/PointCloud2", 12, ["sensor_msgs/", "PointCloud2"]),
        ("12 messages/s", 10, ["12", "messages/s"]),
        ("gpu,camera", 6, ["gpu,", "camera"]),
        ("0123456789", 4, ["0123", "4567", "89"]),
        ("a 0123456789 b", 4, ["a", "0123", "4567", "89 b"]),
        ("機械学習", 4, ["機械", "学習"]),
    ],
)
def test_text_is_broken_between_words(text: str, width: int, lines: list[str]) -> None:
    assert wrap(text, width) == lines


@given(st.text(alphabet="ab/, _é機", max_size=60), st.integers(min_value=2, max_value=20))
def test_wrapped_lines_fit_and_lose_only_blanks(text: str, width: int) -> None:
    lines = wrap(text, width)
    assert max(map(text_width, lines)) <= width
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")


@pytest.mark.parametrize(("text", "width"), [("abc", 3), ("機械", 4), ("é", 1), ("e\u0301", 1)])
def test_wide_and_combining_characters_are_measured_as_a_terminal_shows_them(text: str, width: int) -> None:
    assert text_width(text) == width


def test_characters_that_control_a_terminal_are_removed() -> None:
    assert printable("\x07bell \x1b[31mred\r\n") == "bell [31mred  "
    assert printable("plain é") == "plain é"


def test_plain_columns_are_as_wide_as_their_cells() -> None:
    assert plain([NAMES, ("機械", "a"), ("b", "c")]) == ["NAME  TEXT", "機械  a", "b     c"]


def test_table_that_fits_is_not_changed() -> None:
    table = [("NAME", "NOTHING"), ("a", "-")]
    assert fit(table, 13).lines == plain(table)


def test_empty_columns_are_dropped_only_for_lack_of_width() -> None:
    found = fit([("NAME", "NOTHING", "TEXT"), ("a", "-", "b")], 16)
    assert (found.lines, found.left_out) == (["NAME  TEXT", "a     b"], [])


def test_first_column_is_kept_even_if_empty() -> None:
    assert fit([("", "NAME", "TEXT"), ("-", "a", "0123456")], 14).lines[1].startswith("-")


def test_cells_are_wrapped_before_columns_are_left_out() -> None:
    found = fit([("NAME", "LAST USED"), ("pose", "2030-01-31 08:00:00")], 18)
    assert found.lines == ["NAME  LAST USED", "pose  2030-01-31", "      08:00:00"]
    assert (found.title_lines, found.left_out) == (1, [])


def test_titles_are_wrapped_too() -> None:
    found = fit([("NAME", "SLOTS USED", "OF"), ("m1", "3", "10")], 15)
    assert found.lines == ["NAME  SLOTS  OF", "      USED", "m1    3      10"]
    assert found.title_lines == 2


def test_columns_are_left_out_from_the_right() -> None:
    found = fit([("NAME", "STATE", "GROUP", "IMAGE"), ("brain", "ready", "fleet", "mapping")], 14)
    assert found.lines == ["NAME   STATE", "brain  ready"]
    assert found.left_out == ["GROUP", "IMAGE"]


def test_names_in_the_first_column_stay_whole() -> None:
    found = fit([("INTERFACE", "KIND", "TYPE"), ("scout/camera", "Publisher", "sensor_msgs/Image")], 40)
    assert found.lines[1:] == ["scout/camera  Publisher  sensor_msgs/", "                         Image"]


def test_long_word_does_not_push_its_column_out() -> None:
    found = fit([NAMES, ("token", "0123456789" * 3)], 20)
    assert found.left_out == []
    assert "".join(line[7:] for line in found.lines[1:]) == "0123456789" * 3


def test_terminal_narrower_than_the_first_column_gets_that_column_alone() -> None:
    found = fit([NAMES, ("0123456789", "text")], 6)
    assert found.left_out == ["TEXT"]
    assert "".join(found.lines[found.title_lines :]) == "0123456789"


WORDS = st.text(alphabet="ab", min_size=1, max_size=8)


@given(
    st.integers(min_value=40, max_value=100).flatmap(
        lambda width: st.tuples(
            st.just(width),
            st.lists(
                st.lists(st.lists(WORDS, min_size=1, max_size=4).map(" ".join), min_size=4, max_size=4), min_size=1
            ),
        )
    )
)
def test_no_line_is_longer_than_the_terminal_and_no_word_is_broken(case: tuple[int, list[list[str]]]) -> None:
    width, rows = case
    found = fit([["ONE", "TWO", "THREE", "FOUR"], *rows], width)
    assert max(map(len, found.lines)) <= width
    shown = 4 - len(found.left_out)
    expected = [word for row in rows for cell in row[:shown] for word in cell.split()]
    printed = [word for line in found.lines[found.title_lines :] for word in line.split()]
    assert sorted(printed) == sorted(expected)

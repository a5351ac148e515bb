"""Options that the commands of `rce bench` share."""

from __future__ import annotations

import pytest

from rce.cli.lazy import bench_options
from rce.errors import InvalidRequest


@pytest.mark.parametrize(
    ("text", "names"), [("", []), ("graph", ["graph"]), ("particle,,graph", ["graph", "particle"])]
)
def test_names_of_a_list_are_in_the_order_of_the_known_ones(text: str, names: list[str]) -> None:
    assert bench_options.parse_names("mapper", text, ["graph", "particle"]) == names


def test_list_of_numbers() -> None:
    assert bench_options.numbers("1,20", "--robots") == [1, 20]
    for text in ("", "1,0", "-1", "1,x"):
        with pytest.raises(InvalidRequest, match="--robots"):
            bench_options.numbers(text, "--robots")

"""Facts that follow from acknowledged commands."""

from __future__ import annotations

import pytest

from rce.bench.chaos.model import Fact, Model, Step, connection

FACTS: set[Fact] = {
    ("environment", "e"),
    ("environment", "other"),
    ("node", "e", "n"),
    ("parameter", "e", "p", "1"),
    ("interface", "e", "i"),
    ("interface", "r", "i"),
    connection("r/i", "e/i"),
}


def test_connection_does_not_depend_on_the_order_of_its_ends() -> None:
    assert connection("r/i", "e/i") == connection("e/i", "r/i")


def test_parameter_has_the_last_value() -> None:
    model = Model(FACTS)
    model.acknowledge(Step("add", ("parameter", "e", "p", "2")))
    assert model.of_kind("parameter", "e", "p") == [("parameter", "e", "p", "2")]
    assert model.acknowledged == 1


@pytest.mark.parametrize(
    ("removed", "left"),
    [
        (("environment", "e"), {("environment", "other"), ("interface", "r", "i")}),
        (("interface", "r", "i"), FACTS - {("interface", "r", "i"), connection("r/i", "e/i")}),
        (("node", "e", "n"), FACTS - {("node", "e", "n")}),
    ],
)
def test_removed_thing_takes_along_what_depends_on_it(removed: Fact, left: set[Fact]) -> None:
    model = Model(FACTS)
    model.acknowledge(Step("remove", removed))
    assert model.facts == left


def test_step_reads_as_a_sentence() -> None:
    assert str(Step("remove", ("node", "e", "n"))) == "remove node e n"

"""`catalogue`."""

from __future__ import annotations

import pytest

from rce.api.views import InstanceView, NewOffer, OfferView
from rce.cli.commands import catalogue
from tests.support.console import Console, Request

OFFER = OfferView("@rce", NewOffer("mapping2d"), [InstanceView("ann", "m", "ready", ["ann/r1"], False)], {"ann": 2})


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("bob/echo", ["GET catalogue/bob/echo"]),
        ("mapping2d", ["GET catalogue", "GET catalogue/@rce/mapping2d"]),
        ("own", ["GET catalogue", "GET catalogue/ann/own"]),
    ],
)
def test_service_is_found_by_its_publisher_or_among_those_of_rce(name: str, lines: list[str]) -> None:
    console = Console(*([OFFER] for _ in lines[1:]), OFFER)
    console.run(f"catalogue show {name}")
    assert [each.line for each in console.api.requests] == lines


def test_robot_uses_a_service() -> None:
    made = Console().request("catalogue use bob/echo --robot r1 --as ears")
    assert made == Request("POST catalogue/bob/echo/uses", {}, {"robot": "r1", "containerTag": "ears"})


def test_bounds_are_set_and_a_service_removed() -> None:
    changed = Console(OFFER).request("catalogue scale echo 1 4")
    assert changed == Request("PATCH catalogue/ann/echo", {}, {"least": 1, "most": 4})
    assert Console().request("catalogue remove echo").line == "DELETE catalogue/ann/echo"


def test_publisher_reads_instances_and_uses(capsys: pytest.CaptureFixture[str]) -> None:
    Console(OFFER).request("catalogue show @rce/mapping2d")
    shown = capsys.readouterr().out
    assert "used by ann: 2 times" in shown
    assert "ready, outdated" in shown
    assert catalogue.reference(OFFER) == "mapping2d"

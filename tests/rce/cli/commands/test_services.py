"""`service`."""

from __future__ import annotations

import pytest

from rce.api.views import InstanceView, NewOffer, OfferView
from rce.cli import execute
from rce.cli.commands import services
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
    console.run(f"service show {name}")
    assert [each.line for each in console.api.requests] == lines


def test_robot_uses_a_service() -> None:
    made = Console().request("service use bob/echo --robot r1 --as ears")
    assert made == Request("POST catalogue/bob/echo/uses", {}, {"robot": "r1", "containerTag": "ears"})


def test_bounds_are_set_and_a_service_removed() -> None:
    changed = Console(OFFER).request("service scale echo 1 4")
    assert changed == Request("PATCH catalogue/ann/echo", {}, {"least": 1, "most": 4})
    assert Console().request("service remove echo").line == "DELETE catalogue/ann/echo"


def test_publisher_reads_instances_and_uses(capsys: pytest.CaptureFixture[str]) -> None:
    Console(OFFER).request("service show @rce/mapping2d")
    shown = capsys.readouterr().out
    assert "used by ann: 2 times" in shown
    assert "ready, outdated" in shown
    assert services.reference(OFFER) == "mapping2d"


def test_services_of_the_catalogue_are_listed_or_the_ros_services_of_an_environment() -> None:
    assert Console([OFFER]).request("service list").line == "GET catalogue"
    assert Console([]).request("service list brain --of bob") == Request(
        "GET environments/brain/services", {"user": "bob"}, None
    )


def test_services_of_the_catalogue_are_those_of_no_user(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console().run("service list --of bob") != execute.SUCCESS
    assert "--of needs ENV" in capsys.readouterr().err

"""The catalogue: what is published, who sees it, and what is wrong with a declaration."""

from __future__ import annotations

from typing import Any

import pytest

from master.graph import catalogue, sessions
from master.graph.packages import add, named
from master.graph.records import Version
from rce.api.views import NewOffer, OfferedNode
from rce.errors import InvalidRequest, NotFound
from rce.protocol import messages as m
from tests.support.master.fleet import furnished
from tests.support.master.offers import STRING, declared, offering


def test_published_service_is_found_by_its_name() -> None:
    fleet, offer = offering()
    assert catalogue.resolve(fleet.state, "ann", "parrot") is offer
    assert catalogue.resolve(fleet.state, "bob", "ann/parrot") is offer
    assert catalogue.visible(fleet.state, "bob") == [offer]


def test_service_that_is_not_shared_does_not_exist_for_others() -> None:
    fleet, offer = offering(share=["carl"])
    for user, found in (("ann", [offer]), ("carl", [offer]), ("bob", [])):
        assert catalogue.visible(fleet.state, user) == found
    with pytest.raises(NotFound) as hidden:
        catalogue.resolve(fleet.state, "bob", "ann/parrot")
    with pytest.raises(NotFound) as absent:
        catalogue.resolve(fleet.state, "bob", "ann/parrod")
    assert str(hidden.value).replace("parrot", "") == str(absent.value).replace("parrod", "")


def test_own_service_comes_before_one_that_comes_with_rce() -> None:
    fleet, own = offering()
    shipped = catalogue.offer_of(catalogue.SHIPPED, declared(share=["*"]), "1")
    fleet.state.offers.put(shipped)
    assert catalogue.resolve(fleet.state, "ann", "parrot") is own
    assert catalogue.resolve(fleet.state, "bob", "parrot") is shipped


def test_declaration_is_returned_as_it_was_given() -> None:
    _, offer = offering(parameters={"speed": 2}, mostPerUser=1, environment=m.ContainerData(memory=5))
    given = catalogue.declaration(offer)
    again = catalogue.offer_of("ann", given, offer.revision)
    assert again == offer


def test_service_gets_secrets_of_its_publisher_only() -> None:
    environment = m.ContainerData(secrets={"database": "URL"})
    with pytest.raises(InvalidRequest, match=r"environment\.secrets: .* belongs to the robot's user"):
        catalogue.offer_of("ann", declared(environment=environment, robots=1, most=1), "1")
    offer = catalogue.offer_of("ann", declared(environment=environment), "1")
    assert offer.options.secrets == {"database": "URL"}


def test_packages_of_the_publisher_are_resolved_once_and_kept() -> None:
    fleet = furnished()
    add(fleet.state, "ann", "nodes", Version("a" * 64, 1, ["p"], 0))
    wanted = declared(environment=m.ContainerData(packages=["nodes"]))
    offer = catalogue.publish(fleet.state, "ann", wanted, fleet.ids)
    add(fleet.state, "ann", "nodes", Version("b" * 64, 1, ["p"], 0))
    assert offer.packages == ["a" * 64]
    assert named(fleet.state) == {"a" * 64, "b" * 64}


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"name": "no-tag"}, "name"),
        ({"takes": {"say": "String"}}, "className"),
        ({"takes": {"9": STRING}}, "takes.9"),
        ({"takes": {"say": STRING}, "gives": {"say": STRING}}, "name"),
        ({"gives": {"news": {"type": STRING, "address": "a b"}}}, "gives.news"),
        ({"nodes": [OfferedNode("n", "p", "e"), OfferedNode("n", "p", "f")]}, "nodeTag"),
        ({"least": 3}, "least"),
        ({"robots": 1}, ""),
        ({"environment": m.ContainerData(group="g")}, "environment"),
        ({"parameters": {"p": {"a": 2**70}}}, "parameters"),
    ],
)
def test_wrong_declaration_is_refused(changes: dict[str, Any], field: str) -> None:
    import msgspec

    fleet = furnished()
    wanted = declared(**changes)
    if "gives" in changes:
        wanted = msgspec.convert(msgspec.to_builtins(wanted), NewOffer)
    with pytest.raises(InvalidRequest) as refused:
        catalogue.publish(fleet.state, "ann", wanted, fleet.ids)
    assert (refused.value.info.field or "") == field
    assert len(fleet.state.offers) == 0


def test_bounds_are_changed_for_shared_instances_only() -> None:
    fleet, offer = offering()
    assert catalogue.scale(fleet.state, offer, 1, 5).most == 5
    _, single = offering(robots=1, most=1)
    with pytest.raises(InvalidRequest):
        catalogue.scale(fleet.state, single, 1, 2)


def test_removed_publisher_takes_services_and_instances_along() -> None:
    fleet, _ = offering()
    fleet.do("bob", m.UseService("ann/parrot"), robot="r1")
    sessions.user_gone(fleet.state, "ann")
    for table in (fleet.state.offers, fleet.state.instances, fleet.state.uses, fleet.state.tallies):
        assert len(table) == 0
    assert fleet.state.interfaces.by("bob/r1") == []


def test_services_of_users_who_are_gone_are_dropped_at_the_start() -> None:
    fleet, _ = offering(share=["bob", "carl"])
    catalogue.drop_strays(fleet.state, {"ann", "bob"})
    assert [offer.shared for offer in fleet.state.offers] == [["bob"]]
    catalogue.drop_strays(fleet.state, {"bob"})
    assert len(fleet.state.offers) == 0

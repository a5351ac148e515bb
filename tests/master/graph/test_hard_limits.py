"""Hard limits, which hold for every user."""

from __future__ import annotations

import pytest

from master.graph import hard_limits
from rce.errors import LimitExceeded
from rce.protocol import messages as m
from tests.support.master.fleet import furnished, interface


def test_number_of_items_of_an_owner_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("NODES", "PARAMETERS", "INTERFACES"):
        monkeypatch.setattr(hard_limits, name, 2)
    fleet = furnished()
    for tag in ("a", "b"):
        fleet.do("ann", m.AddNode("brain", tag, "p", "e"))
        fleet.do("ann", m.SetParameter("brain", tag, 1))
        fleet.do("ann", interface("brain", tag, "PublisherInterface"))
        fleet.do("ann", interface("r1", tag, "PublisherConverter"))
    for command in (
        m.AddNode("brain", "c", "p", "e"),
        m.SetParameter("brain", "c", 1),
        interface("brain", "c", "PublisherInterface"),
        interface("r1", "c", "PublisherConverter"),
    ):
        with pytest.raises(LimitExceeded, match="has 2"):
            fleet.do("ann", command)
    fleet.do("ann", m.SetParameter("brain", "a", 2))
    fleet.do("bob", interface("r1", "a", "PublisherConverter"))


def test_size_of_parameters_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hard_limits, "PARAMETER_TEXT", 5000)
    fleet = furnished()
    fleet.do("ann", m.SetParameter("brain", "a", "x" * 3000))
    fleet.do("ann", m.SetParameter("brain", "a", "x" * 4000))  # replaces the other
    too_large: list[m.ParameterValue] = ["x" * 2000, ["x" * 1000] * 2, [1] * 2000, [[[]] * 2000], {"x" * 2000: {}}]
    for value in too_large:
        with pytest.raises(LimitExceeded, match="5000 characters"):
            fleet.do("ann", m.SetParameter("brain", "b", value))
    fleet.do("ann", m.SetParameter("brain", "b", "x" * 10))


def test_number_of_connections_that_must_not_drop_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hard_limits, "KEEP_ALL", 2)
    fleet = furnished()
    for tag in "abcd":
        qos = m.Qos() if tag == "d" else m.Qos(history="keep_all")
        fleet.do("ann", interface("r1", tag, "SubscriberConverter"))
        fleet.do("ann", interface("brain", tag, "PublisherInterface", qos=qos))
    for tag in "abd":
        fleet.do("ann", m.Connect(f"r1/{tag}", f"brain/{tag}"))
    with pytest.raises(LimitExceeded, match="2 connections with history keep_all"):
        fleet.do("ann", m.Connect("r1/c", "brain/c"))
    fleet.do("ann", m.Disconnect("r1/a", "brain/a"))
    fleet.do("ann", m.Connect("r1/c", "brain/c"))

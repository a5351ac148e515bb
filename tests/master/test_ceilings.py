"""What one user may have at most, whatever their limits say."""

from __future__ import annotations

import pytest
from fleet import furnished, interface

from master import ceilings
from rce import messages as m
from rce.errors import LimitExceeded


def test_a_robot_and_an_environment_have_so_many_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("NODES", "PARAMETERS", "INTERFACES"):
        monkeypatch.setattr(ceilings, name, 2)
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


def test_parameters_have_so_much_text(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ceilings, "PARAMETER_TEXT", 5000)
    fleet = furnished()
    fleet.do("ann", m.SetParameter("brain", "a", "x" * 3000))
    fleet.do("ann", m.SetParameter("brain", "a", "x" * 4000))  # in place of the other
    for value in ("x" * 2000, ["x" * 1000] * 2, [1] * 2000):
        with pytest.raises(LimitExceeded, match="5000 characters"):
            fleet.do("ann", m.SetParameter("brain", "b", value))
    fleet.do("ann", m.SetParameter("brain", "b", "x" * 10))

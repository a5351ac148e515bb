"""Directories of a task set on a node."""

from __future__ import annotations

from pathlib import Path

from containers.kubernetes.places import Places, endpoint_paths

RUN = "1" * 32


def test_what_an_environment_sees_is_apart_from_what_only_the_agent_sees() -> None:
    places = Places.of("/var/lib/rce", "t")
    seen = {places.control(RUN), places.packages(RUN)}
    for hidden in (places.record(RUN), places.disk(RUN)):
        assert not any(hidden.is_relative_to(each) for each in seen)
    assert places.root == Path("/var/lib/rce/t")


def test_environments_of_a_user_share_the_directory_of_their_sockets() -> None:
    places = Places.of("/var/lib/rce", "t")
    assert places.sockets("ann/map") == places.sockets("ann/plan")
    assert places.sockets("ann/map") != places.sockets("bob/map")
    assert places.socket("ann/map", RUN).name == endpoint_paths(RUN).socket.name

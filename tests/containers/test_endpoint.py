"""Variables and paths of an endpoint in a container."""

from __future__ import annotations

from containers.endpoint import FIRST_USER, environment_user, reference
from rce import __version__


def test_image_without_tag_gets_the_tag_of_this_version() -> None:
    assert reference("rce/base") == f"rce/base:{__version__}"
    assert reference("registry:5000/mine") == f"registry:5000/mine:{__version__}"
    assert reference("rce/base:7") == "rce/base:7"
    assert reference("mine@sha256:0") == "mine@sha256:0"


def test_each_user_has_a_user_of_the_host() -> None:
    """It is the same for all environments of a user, and after a restart."""
    ann = environment_user("ann/map")
    assert ann == environment_user("ann/plan")
    assert ann != environment_user("bob/map")
    assert FIRST_USER <= ann < 2**31  # Docker refuses larger ones


def test_mapped_users_are_among_those_that_a_user_namespace_has() -> None:
    ids = {environment_user(f"user{number}/map", mapped=True) for number in range(1000)}
    assert all(10_000 <= each < 65_536 for each in ids)

"""Packages of users: references, visibility, sharing, quota and removal."""

from __future__ import annotations

import pytest

from master.graph import packages
from master.graph.records import Version
from master.graph.state import State
from rce.control.calls.environments import StartEnvironment
from rce.errors import InvalidName, InvalidRequest, LimitExceeded, NotFound
from rce.protocol.messages import ContainerData, CreateContainer, DestroyContainer
from tests.support.master.fleet import Fleet, calls, furnished


def version(number: int, size: int = 10) -> Version:
    return Version(f"{number:064x}"[::-1], size, ["p"], 0)


@pytest.fixture
def state() -> State:
    """Ann has `own` (two versions), `lent` to bob, `free` for everybody; bob has `own` too."""
    state = State()
    for number in (1, 2):
        packages.add(state, "ann", "own", version(number))
    packages.add(state, "ann", "lent", version(3))
    packages.add(state, "ann", "free", version(4))
    packages.add(state, "bob", "own", version(5))
    packages.share(state, "ann", "lent", ["bob", "ann"])
    packages.share(state, "ann", "free", ["*"])
    return state


FOUND = {
    ("ann", "own"): 2,
    ("ann", "ann/own"): 2,
    ("ann", f"own@{version(1).digest}"): 1,
    ("ann", f"own@{version(1).digest[:8]}"): 1,
    ("ann", "lent"): 3,
    ("ann", "bob/own"): None,
    ("bob", "own"): 5,
    ("bob", "bob/own"): 5,
    ("bob", "ann/lent"): 3,
    ("bob", f"ann/lent@{version(3).digest[:12]}"): 3,
    ("bob", f"ann/lent@{version(1).digest}"): None,
    ("bob", "ann/free"): 4,
    ("bob", "ann/own"): None,
    ("bob", f"ann/own@{version(1).digest}"): None,
    ("bob", "lent"): None,
    ("bob", "free"): None,
    ("eve", "ann/free"): 4,
    ("eve", "ann/lent"): None,
    ("eve", "ann/own"): None,
    ("eve", "own"): None,
    ("eve", "bob/own"): None,
    ("*", "ann/lent"): None,
    ("eve", "nobody/own"): None,
}


@pytest.mark.parametrize(("user", "reference"), FOUND)
def test_reference_resolves_for_who_may_use_the_package(state: State, user: str, reference: str) -> None:
    expected = FOUND[user, reference]
    if expected is not None:
        assert packages.resolve(state, user, reference).digest == version(expected).digest
        return
    with pytest.raises(NotFound):
        packages.resolve(state, user, reference)


@pytest.mark.parametrize(
    ("user", "names"),
    [
        ("ann", {"ann/own", "ann/lent", "ann/free"}),
        ("bob", {"bob/own", "ann/lent", "ann/free"}),
        ("eve", {"ann/free"}),
        ("*", {"ann/free"}),
    ],
)
def test_visible_packages_of_each_user(state: State, user: str, names: set[str]) -> None:
    assert {package.name for package in packages.visible(state, user)} == names


@pytest.mark.parametrize("reference", ["", "/", "a/b/c", "own@", "own@xyz", "own@abc", "@12345678", "ann/"])
def test_malformed_reference_is_refused(state: State, reference: str) -> None:
    with pytest.raises(InvalidRequest):
        packages.resolve(state, "ann", reference)


def test_ambiguous_version_prefix_is_refused(state: State) -> None:
    packages.add(state, "ann", "own", Version(version(1).digest[:20] + "f" * 44, 1, [], 0))
    with pytest.raises(InvalidRequest, match="not one but 2"):
        packages.resolve(state, "ann", f"own@{version(1).digest[:20]}")


def test_older_version_pushed_again_becomes_the_newest(state: State) -> None:
    packages.add(state, "ann", "own", version(1))
    assert packages.resolve(state, "ann", "own").digest == version(1).digest
    assert len(state.packages["ann/own"].versions) == 2


def test_unshared_package_is_not_found(state: State) -> None:
    packages.share(state, "ann", "lent", ["eve"])
    packages.unshare(state, "ann", "lent", ["bob"])
    assert state.packages["ann/lent"].shared == ["eve"]
    packages.unshare(state, "ann", "lent", [])
    for user in ("bob", "eve"):
        with pytest.raises(NotFound):
            packages.resolve(state, user, "ann/lent")


def test_packages_of_others_cannot_be_changed(state: State) -> None:
    for change in (packages.share, packages.unshare):
        with pytest.raises(NotFound):
            change(state, "bob", "lent", ["eve"])
    with pytest.raises(NotFound):
        packages.remove(state, "bob", "lent")


def test_versions_and_packages_are_removed(state: State) -> None:
    packages.remove(state, "ann", "own", version(2).digest[:10])
    assert packages.resolve(state, "ann", "own").digest == version(1).digest
    packages.remove(state, "ann", "own", version(1).digest)
    packages.remove(state, "ann", "lent")
    assert {package.name for package in packages.visible(state, "ann")} == {"ann/free"}
    assert packages.named(state) == {version(number).digest for number in (4, 5)}


def test_quota_counts_archives_once(state: State) -> None:
    packages.add(state, "ann", "again", version(1))  # the same archive is counted once
    assert packages.usage(state, "ann") == 40
    packages.check_quota(state, "ann", version(9).digest, 10, quota=50)
    packages.check_quota(state, "ann", version(9).digest, 10**9, quota=None)
    with pytest.raises(LimitExceeded):
        packages.check_quota(state, "ann", version(9).digest, 1, quota=0)
    packages.check_quota(state, "ann", version(1).digest, 10, quota=40)
    with pytest.raises(LimitExceeded, match=r"40 bytes, with this one 51.*50") as raised:
        packages.check_quota(state, "ann", version(9).digest, 11, quota=50)
    assert raised.value.info.fields == {"asked": 51, "limit": 50}
    with pytest.raises(LimitExceeded):
        packages.check_quota(state, "ann", version(9).digest, 10, quota=50, reserved=1)
    with pytest.raises(LimitExceeded):  # bob's archive does not count for ann
        packages.check_quota(state, "ann", version(5).digest, 11, quota=50)


def test_number_of_versions_is_limited() -> None:
    state = State()
    for number in range(packages.MOST_VERSIONS):
        packages.add(state, "ann", "own", version(number))
    with pytest.raises(LimitExceeded):
        packages.add(state, "ann", "own", version(packages.MOST_VERSIONS))


@pytest.mark.parametrize("name", ["", "a/b", "../x", "a@b", "a-b", "*"])
def test_illegal_package_names_are_refused(name: str) -> None:
    with pytest.raises(InvalidName):
        packages.add(State(), "ann", name, version(1))


def test_packages_of_removed_users_are_dropped(state: State) -> None:
    packages.drop_strays(state, {"ann", "eve"})
    assert {package.name for package in state.packages} == {"ann/own", "ann/lent", "ann/free"}
    assert state.packages["ann/lent"].shared == []
    assert state.packages["ann/free"].shared == ["*"]


# --- environments ---


def create(fleet: Fleet, user: str, *references: str) -> StartEnvironment:
    outcome = fleet.do(user, CreateContainer("e", ContainerData(packages=[*references])))
    (call,) = calls(outcome.plan)
    assert isinstance(call, StartEnvironment)
    return call


def test_environment_keeps_the_versions_of_its_start() -> None:
    fleet = furnished()
    packages.add(fleet.state, "ann", "own", version(1))
    packages.share(fleet.state, "ann", "own", ["bob"])
    assert create(fleet, "bob", "ann/own", f"ann/own@{version(1).digest}").environment.packages == [version(1).digest]
    packages.add(fleet.state, "ann", "own", version(2))
    packages.remove(fleet.state, "ann", "own")
    plan = fleet.join("m1", "container", "2", capacity=4)  # the machine has lost it: it is started again
    again = [step.call for steps in plan for step in steps if hasattr(step, "call")]
    started = [call.environment for call in again if isinstance(call, StartEnvironment)]
    assert [spec.packages for spec in started if spec.name == "bob/e"] == [[version(1).digest]]
    assert packages.named(fleet.state) == {version(1).digest}
    fleet.do("bob", DestroyContainer("e"))
    assert packages.named(fleet.state) == set()


@pytest.mark.parametrize("reference", ["ann/own", "own", "ann/own@12345678", "ann/"])
def test_private_package_of_another_user_is_not_found(reference: str) -> None:
    fleet = furnished()
    packages.add(fleet.state, "ann", "own", version(1))
    with pytest.raises((NotFound, InvalidRequest)) as raised:
        create(fleet, "bob", reference)
    assert raised.value.field == "containerData.packages"
    assert "bob/e" not in fleet.state.environments

"""What users may have: refused beyond it with the numbers, filled in where nothing is asked."""

from __future__ import annotations

from typing import Any

import pytest
from fleet import everything, furnished, interface, wired

from master.__main__ import Settings, platform_policy
from master.policies import UNLIMITED, Policy, check_totals, granted, is_allowed, parse, usage, with_changes
from master.records import Environment, State
from rce import messages as m
from rce.errors import InvalidRequest, LimitExceeded
from rce.messages import ContainerData, Rates
from rce.settings import load

GB = 10**9


@pytest.mark.parametrize(
    ("field", "policy", "options", "numbers"),
    [
        ("size", Policy(size=2), ContainerData(size=3), (3, 2)),
        ("cpu", Policy(cpu=1.5), ContainerData(cpu=1.6), (1.6, 1.5)),
        ("memory", Policy(memory=GB), ContainerData(memory=GB + 1), (GB + 1, GB)),
        ("pids", Policy(pids=10), ContainerData(pids=11), (11, 10)),
        ("disk", Policy(disk=GB), ContainerData(disk=2 * GB), (2 * GB, GB)),
        ("bandwidth", Policy(bandwidth=100), ContainerData(bandwidth=101), (101, 100)),
        ("io.read", Policy(io=100), ContainerData(io=Rates(read=101)), (101, 100)),
        ("io.write", Policy(io=100), ContainerData(io=Rates(write=200)), (200, 100)),
        ("gpus", Policy(gpus=1), ContainerData(gpus=2), (2, 1)),
    ],
)
def test_more_than_an_environment_may_have(
    field: str, policy: Policy, options: ContainerData, numbers: tuple[float, float]
) -> None:
    with pytest.raises(LimitExceeded) as raised:
        granted(policy, options)
    assert raised.value.field == f"containerData.{field}"
    assert (raised.value.info.fields["asked"], raised.value.info.fields["limit"]) == numbers
    assert all(f"{number:g}" in str(raised.value) or str(number) in str(raised.value) for number in numbers)
    assert granted(UNLIMITED, options) == options


def test_what_an_environment_gets_that_does_not_ask() -> None:
    """The default; without one the ceiling, since no limit would be more than that."""
    policy = Policy(cpu=2, default_cpu=0.5, memory=GB, io=100, bandwidth=50, default_bandwidth=80)
    got = granted(policy, ContainerData())
    assert got == ContainerData(cpu=0.5, memory=GB, bandwidth=50, io=Rates(100, 100))
    assert granted(policy, ContainerData(cpu=2)).cpu == 2
    assert granted(UNLIMITED, ContainerData()) == ContainerData()


@pytest.mark.parametrize(
    ("image", "patterns", "allowed"),
    [
        ("rce/base", ["rce/base"], True),
        ("rce/base:0.1.0", ["rce/base"], True),
        ("rce/base:0.1.0", ["rce/base:0.2.0"], False),
        ("rce/basement", ["rce/base"], False),
        ("mine/anything:3", ["mine/*"], True),
        ("registry:5000/mine", ["registry:5000/mine"], True),
        ("registry:5000/mine", ["registry"], False),
        ("rce/base", [], False),
    ],
)
def test_images(image: str, patterns: list[str], allowed: bool) -> None:
    assert is_allowed(image, patterns) == allowed
    policy = Policy(images=patterns)
    assert granted(policy, ContainerData()).image == ""
    if not allowed:
        with pytest.raises(LimitExceeded, match=image) as raised:
            granted(policy, ContainerData(image=image))
        assert raised.value.field == "containerData.image"


@pytest.mark.parametrize(
    ("policy", "options", "asked", "limit"),
    [
        (Policy(environments=1), ContainerData(), 2, 1),
        (Policy(cores=2), ContainerData(cpu=1.5), 2.5, 2),
        (Policy(cores=2), ContainerData(size=2), 3, 2),
        (Policy(total_memory=2 * 2**30), ContainerData(memory=2**30 + 1), 2**31 + 1, 2**31),
    ],
)
def test_more_than_a_user_may_have(policy: Policy, options: ContainerData, asked: float, limit: float) -> None:
    """The user has one environment of one slot already; another user's do not count."""
    fleet = furnished()
    fleet.do("bob", m.CreateContainer("other"))
    fleet.policy = policy
    before = everything(fleet.state)
    with pytest.raises(LimitExceeded) as raised:
        fleet.do("ann", m.CreateContainer("second", options))
    assert raised.value.info.fields == {"asked": asked, "limit": limit}
    assert everything(fleet.state) == before
    fleet.do("ann", m.DestroyContainer("brain"))
    fleet.do("ann", m.CreateContainer("second"))


def test_more_connections_than_a_user_may_have() -> None:
    fleet = wired()
    fleet.policy = Policy(connections=1)
    fleet.do("ann", interface("brain", "copy", "PublisherInterface"))
    with pytest.raises(LimitExceeded, match="connections: 2") as raised:
        fleet.do("ann", m.Connect("r1/pose", "brain/copy"))
    assert raised.value.info.fields == {"asked": 2, "limit": 1}
    fleet.do("ann", m.Disconnect("r1/pose", "brain/pose"))
    fleet.do("ann", m.Connect("r1/pose", "brain/copy"))


def test_more_robots_than_a_user_may_have() -> None:
    """One that comes back with its token is no further one."""
    fleet = furnished()
    fleet.policy = Policy(robots=1)
    with pytest.raises(LimitExceeded, match="robots: 2"):
        fleet.robot("ann/r2")
    assert fleet.robot("ann/r1", session="t", resume="s")[1]


@pytest.mark.parametrize(
    ("assignment", "value"),
    [
        ("memory=2GiB", 2**31),
        ("memory=1.5G", 1_500_000_000),
        ("memory=4096", 4096),
        ("bandwidth=20 MB", 20_000_000),
        ("cpu=0.5", 0.5),
        ("pids=", None),
        ("images=mine/*,theirs", ["mine/*", "theirs"]),
    ],
)
def test_limits_from_a_command_line(assignment: str, value: Any) -> None:
    assert parse([assignment]) == {assignment.partition("=")[0]: value}


@pytest.mark.parametrize("wrong", ["memory", "speed=1", "memory=much", "memory=-1", "pids=0.5", "size=1e3 "])
def test_limits_that_are_none(wrong: str) -> None:
    with pytest.raises(InvalidRequest, match=wrong.partition("=")[0]):
        parse([wrong])


def test_changes_of_a_later_version_are_left_out() -> None:
    assert with_changes(Policy(size=2), {"cpu": 1.0, "size": None, "unheard": 1}) == Policy(size=2, cpu=1.0)


def test_limits_as_settings_of_the_master() -> None:
    given = load(Settings, "rce master", ["--data-dir=/x", "--limits=memory=2GiB,robots=3", "--images=mine/*"], {})
    policy = platform_policy(given)
    assert (policy.memory, policy.robots, policy.images) == (2**31, 3, ["rce/base", "rce/mapping", "mine/*"])
    with pytest.raises(InvalidRequest, match="speed"):
        platform_policy(load(Settings, "rce master", ["--data-dir=/x", "--limits=speed=1"], {}))


def test_bandwidth_of_all_environments_together() -> None:
    """One that asks for none has the most that it could ask for, or what has none could not be counted."""
    policy = Policy(total_bandwidth=1000)
    state = State()
    for tag, asks, gets in (("a", 400, 400), ("b", 0, 0), ("c", 500, 500), ("d", 0, 0)):
        options = granted(policy, ContainerData(bandwidth=asks))
        if not gets:
            assert options.bandwidth == 1000
            with pytest.raises(LimitExceeded, match=r"total_bandwidth: 1[49]00"):
                check_totals(state, "ann", policy, options)
            continue
        check_totals(state, "ann", policy, options)
        state.environments.put(Environment(f"ann/{tag}", options, "0", ""))
    assert usage(state, "ann").total_bandwidth == 900
    assert granted(Policy(bandwidth=300, total_bandwidth=1000), ContainerData()).bandwidth == 300
    assert granted(Policy(default_bandwidth=100, total_bandwidth=1000), ContainerData()).bandwidth == 100

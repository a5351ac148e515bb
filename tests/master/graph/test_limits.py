"""Limits of users: maxima, defaults and totals."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import UNSET

from master.__main__ import Settings, platform_policy
from master.graph.limits import UNLIMITED, Policy, check_totals, granted, is_allowed, parse, usage, with_changes
from master.graph.records import Environment, EnvironmentOptions, IoRates
from master.graph.state import State
from master.graph.translation import container_data
from rce.errors import InvalidRequest, LimitExceeded
from rce.process.settings import load
from rce.protocol import messages as m
from tests.support.master.fleet import everything, furnished, interface, wired

GB = 10**9


@pytest.mark.parametrize(
    ("field", "policy", "options", "numbers"),
    [
        ("size", Policy(size=2), EnvironmentOptions(size=3), (3, 2)),
        ("cpu", Policy(cpu=1.5), EnvironmentOptions(cpu=1.6), (1.6, 1.5)),
        ("memory", Policy(memory=GB), EnvironmentOptions(memory=GB + 1), (GB + 1, GB)),
        ("pids", Policy(pids=100), EnvironmentOptions(pids=101), (101, 100)),
        ("disk", Policy(disk=GB), EnvironmentOptions(disk=2 * GB), (2 * GB, GB)),
        ("bandwidth", Policy(bandwidth=100), EnvironmentOptions(bandwidth=101), (101, 100)),
        ("io.read", Policy(io=100), EnvironmentOptions(io=IoRates(read=101)), (101, 100)),
        ("io.write", Policy(io=100), EnvironmentOptions(io=IoRates(write=200)), (200, 100)),
        ("gpus", Policy(gpus=1), EnvironmentOptions(gpus=2), (2, 1)),
    ],
)
def test_options_above_a_limit_are_refused(
    field: str, policy: Policy, options: EnvironmentOptions, numbers: tuple[float, float]
) -> None:
    with pytest.raises(LimitExceeded) as raised:
        granted(policy, options)
    assert raised.value.field == f"containerData.{field}"
    assert (raised.value.info.fields["asked"], raised.value.info.fields["limit"]) == numbers
    assert all(f"{number:g}" in str(raised.value) or str(number) in str(raised.value) for number in numbers)
    assert granted(UNLIMITED, options) == options


@pytest.mark.parametrize(("policy", "asked"), [(UNLIMITED, 31), (Policy(pids=31), 0), (Policy(default_pids=1), 0)])
def test_environment_gets_as_many_processes_as_it_needs_itself(policy: Policy, asked: int) -> None:
    with pytest.raises(InvalidRequest, match="at least 32 processes and threads") as raised:
        granted(policy, EnvironmentOptions(pids=asked))
    assert raised.value.field == "containerData.pids"
    assert granted(UNLIMITED, EnvironmentOptions(pids=32)).pids == 32


def test_defaults_fill_in_missing_options() -> None:
    """The default applies, or without one the maximum."""
    policy = Policy(cpu=2, default_cpu=0.5, memory=GB, io=100, bandwidth=50, default_bandwidth=80)
    got = granted(policy, EnvironmentOptions())
    assert got == EnvironmentOptions(cpu=0.5, memory=GB, bandwidth=50, io=IoRates(100, 100))
    assert granted(policy, EnvironmentOptions(cpu=2)).cpu == 2
    assert granted(UNLIMITED, EnvironmentOptions()) == EnvironmentOptions()


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
def test_images_match_patterns(image: str, patterns: list[str], allowed: bool) -> None:
    assert is_allowed(image, patterns) == allowed
    policy = Policy(images=patterns)
    assert granted(policy, EnvironmentOptions()).image == ""
    if not allowed:
        with pytest.raises(LimitExceeded, match=image) as raised:
            granted(policy, EnvironmentOptions(image=image))
        assert raised.value.field == "containerData.image"


@pytest.mark.parametrize(
    ("policy", "options", "asked", "limit"),
    [
        (Policy(environments=1), EnvironmentOptions(), 2, 1),
        (Policy(cores=2), EnvironmentOptions(cpu=1.5), 2.5, 2),
        (Policy(cores=2), EnvironmentOptions(size=2), 3, 2),
        (Policy(total_memory=2 * 2**30), EnvironmentOptions(memory=2**30 + 1), 2**31 + 1, 2**31),
    ],
)
def test_totals_above_a_limit_are_refused(
    policy: Policy, options: EnvironmentOptions, asked: float, limit: float
) -> None:
    """The user has one environment of one slot already; those of another user do not count."""
    fleet = furnished()
    fleet.do("bob", m.CreateContainer("other"))
    fleet.policy = policy
    before = everything(fleet.state)
    with pytest.raises(LimitExceeded) as raised:
        fleet.do("ann", m.CreateContainer("second", container_data(options)))
    assert raised.value.info.fields == {"asked": asked, "limit": limit}
    assert everything(fleet.state) == before
    fleet.do("ann", m.DestroyContainer("brain"))
    fleet.do("ann", m.CreateContainer("second"))


def test_number_of_connections_is_limited() -> None:
    fleet = wired()
    fleet.policy = Policy(connections=1)
    fleet.do("ann", interface("brain", "copy", "PublisherInterface"))
    with pytest.raises(LimitExceeded, match="connections: 2") as raised:
        fleet.do("ann", m.Connect("r1/pose", "brain/copy"))
    assert raised.value.info.fields == {"asked": 2, "limit": 1}
    fleet.do("ann", m.Disconnect("r1/pose", "brain/pose"))
    fleet.do("ann", m.Connect("r1/pose", "brain/copy"))


@pytest.mark.parametrize(
    "policy",
    [Policy(**{name: 0}) for name in ("environments", "cores", "total_memory", "total_bandwidth", "size")]
    + [Policy(**{name: 0}) for name in ("cpu", "memory", "pids", "disk", "bandwidth", "io")],
    ids=repr,
)
def test_limit_of_zero_allows_no_environment(policy: Policy) -> None:
    fleet = furnished()
    fleet.policy = policy
    with pytest.raises(LimitExceeded) as raised:
        fleet.do("ann", m.CreateContainer("second"))
    assert raised.value.info.fields["limit"] == 0


def test_limit_of_zero_allows_no_robot_no_connection_and_no_gpu() -> None:
    fleet = wired()
    fleet.policy = Policy(robots=0, connections=0, gpus=0)
    fleet.do("ann", interface("brain", "copy", "PublisherInterface"))
    with pytest.raises(LimitExceeded, match="connections"):
        fleet.do("ann", m.Connect("r1/pose", "brain/copy"))
    with pytest.raises(LimitExceeded, match="robots"):
        fleet.robot("ann/r2")
    assert granted(fleet.policy, EnvironmentOptions()).gpus == 0
    with pytest.raises(LimitExceeded, match="gpus"):
        granted(fleet.policy, EnvironmentOptions(gpus=1))


def test_number_of_robots_is_limited() -> None:
    """A robot that resumes is not counted twice."""
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
        ("pids=", UNSET),
        ("pids=-", None),
        ("default_pids=-", None),
        ("robots=0", 0),
        ("images=mine/*,theirs", ["mine/*", "theirs"]),
    ],
)
def test_limits_are_parsed_from_assignments(assignment: str, value: Any) -> None:
    assert parse([assignment]) == {assignment.partition("=")[0]: value}


@pytest.mark.parametrize(
    "wrong", ["memory", "speed=1", "memory=much", "memory=-1", "pids=0.5", "size=1e3 ", "images=-", "default_cpu=0"]
)
def test_malformed_limits_are_refused(wrong: str) -> None:
    with pytest.raises(InvalidRequest, match=wrong.partition("=")[0]):
        parse([wrong])


def test_unknown_limits_of_a_later_version_are_ignored() -> None:
    assert with_changes(Policy(size=2), {"cpu": 1.0, "size": UNSET, "unheard": 1}) == Policy(size=2, cpu=1.0)


def test_limits_are_a_setting_of_the_master() -> None:
    given = load(Settings, "rce master", ["--data-dir=/x", "--limits=memory=2GiB,robots=3", "--images=mine/*"], {})
    policy = platform_policy(given)
    assert (policy.memory, policy.robots, policy.images) == (
        2**31,
        3,
        ["rce/base", "rce/mapping", "rce/mapping3d", "mine/*"],
    )
    with pytest.raises(InvalidRequest, match="speed"):
        platform_policy(load(Settings, "rce master", ["--data-dir=/x", "--limits=speed=1"], {}))


def test_total_bandwidth_bounds_single_environments() -> None:
    """An environment that asks for none counts with its maximum."""
    policy = Policy(total_bandwidth=1000)
    state = State()
    for tag, asks, gets in (("a", 400, 400), ("b", 0, 0), ("c", 500, 500), ("d", 0, 0)):
        options = granted(policy, EnvironmentOptions(bandwidth=asks))
        if not gets:
            assert options.bandwidth == 1000
            with pytest.raises(LimitExceeded, match=r"total_bandwidth: 1[49]00"):
                check_totals(state, "ann", policy, options)
            continue
        check_totals(state, "ann", policy, options)
        state.environments.put(Environment(f"ann/{tag}", options, "0", ""))
    assert usage(state, "ann").total_bandwidth == 900
    assert granted(Policy(bandwidth=300, total_bandwidth=1000), EnvironmentOptions()).bandwidth == 300
    assert granted(Policy(default_bandwidth=100, total_bandwidth=1000), EnvironmentOptions()).bandwidth == 100

"""What a user may have: ceilings and defaults of each environment, and of all that is theirs together.

Those of the platform are settings of the Master; what an administrator changes for one user is kept in the database
and stands in their place. Nothing here waits: the graph asks before it takes a command.
"""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from master import packages
from master.records import State
from rce import quantities, slots
from rce.calls.environments import Egress
from rce.errors import InvalidRequest, LimitExceeded
from rce.messages import ContainerData, Rates
from rce.views import UsageView

Number = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Cores = Annotated[float, Meta(ge=0)]
IMAGES = ("rce/base", "rce/mapping")  # what `provisioning/provision image` builds
_AMOUNTS = ("cpu", "memory", "pids", "disk", "bandwidth")  # of containerData, with a default and a ceiling each


class Policy(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of one user; 0 is none. Sizes are in bytes, rates in bytes a second."""

    # the most that one environment may ask for; what has no default gets it unless it asks for less
    size: Number = 0
    cpu: Cores = 0
    memory: Number = 0
    pids: Number = 0
    disk: Number = 0
    bandwidth: Number = 0
    io: Number = 0
    gpus: Number = 0

    # what an environment gets that does not ask; 0: what its slots stand for (rce.slots)
    default_cpu: Cores = 0
    default_memory: Number = 0
    default_pids: Number = 0
    default_disk: Number = 0
    default_bandwidth: Number = 0
    default_io: Number = 0

    # what environments reach of the network, besides their group
    egress: Egress = "none"

    # images beside those that all users may have; a name without a tag stands for all of its tags, `*` for any letters
    images: list[str] = []

    # all of the user's together
    environments: Number = 0
    cores: Cores = 0
    total_memory: Number = 0
    total_bandwidth: Number = 0
    robots: Number = 0
    connections: Number = 0
    package_bytes: Number = 0


UNLIMITED = Policy()
NAMES = {field.name: field.type for field in msgspec.structs.fields(Policy)}


def granted(policy: Policy, options: ContainerData) -> ContainerData:
    """What an environment gets that asks for `options`. LimitExceeded with the numbers."""
    _check_image(policy, options.image)
    _check("size", options.size, policy.size)
    _check("gpus", options.gpus, policy.gpus)
    policy = replace(policy, bandwidth=_least(policy.bandwidth, policy.total_bandwidth))  # else none could be counted
    got = {
        name: _grant(name, getattr(options, name), getattr(policy, name), getattr(policy, f"default_{name}"))
        for name in _AMOUNTS
    }
    rates = Rates(
        _grant("io.read", options.io.read, policy.io, policy.default_io),
        _grant("io.write", options.io.write, policy.io, policy.default_io),
    )
    return replace(options, io=rates, **got)


def check_totals(state: State, user: str, policy: Policy, options: ContainerData) -> None:
    """Refuse one more environment if with it the user has too much. LimitExceeded with the numbers."""
    wanted = [*(other.options for other in state.environments.by(user)), options]
    yours = "all of your environments together"
    _check_total("environments", len(wanted), policy.environments, "you")
    _check_total("cores", _cores(wanted), policy.cores, yours)
    _check_total("total_memory", _memory(wanted), policy.total_memory, yours)
    _check_total("total_bandwidth", sum(each.bandwidth for each in wanted), policy.total_bandwidth, yours)


def usage(state: State, user: str) -> UsageView:
    """What a user has of that which limits count."""
    options = [environment.options for environment in state.environments.by(user)]
    return UsageView(
        environments=len(options),
        cores=_cores(options),
        total_memory=_memory(options),
        total_bandwidth=sum(each.bandwidth for each in options),
        robots=state.robots_of_user(user),
        connections=state.connections_of_user(user),
        package_bytes=packages.usage(state, user),
    )


def _cores(wanted: Iterable[ContainerData]) -> float:
    return sum(each.cpu or each.size * slots.CORES for each in wanted)


def _memory(wanted: Iterable[ContainerData]) -> int:
    return sum(each.memory or each.size * slots.MEMORY for each in wanted)


def _least(one: int, other: int) -> int:
    """The smaller of two limits, of which 0 is none."""
    return min(one or other, other or one)


def check_robots(state: State, user: str, policy: Policy) -> None:
    """Refuse one more robot if the user has all that they may."""
    _check_total("robots", state.robots_of_user(user) + 1, policy.robots, "you", "robotID")


def check_connections(state: State, user: str, policy: Policy) -> None:
    """Refuse one more connection if the user has all that they may."""
    _check_total("connections", state.connections_of_user(user) + 1, policy.connections, "you", "tagA")


def is_allowed(image: str, patterns: Iterable[str]) -> bool:
    """Whether one of the patterns says `image`, with or without its tag."""
    name = image.rpartition(":")[0] if ":" in image.rpartition("/")[2] else image
    return any(fnmatchcase(image, pattern) or fnmatchcase(name, pattern) for pattern in patterns)


def parse(assignments: Iterable[str]) -> dict[str, Any]:
    """`["memory=2Gi", "images=rce/base,mine/*", "cpu="]` as fields of a Policy, None if empty. InvalidRequest."""
    found: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise InvalidRequest(f"{assignment!r}: write key=value; keys are {', '.join(NAMES)}", field=name)
        found[name] = text
    return changes(found)


def changes(wanted: dict[str, Any]) -> dict[str, Any]:
    """Fields of a Policy, of values or of what people write for them; None or nothing undoes. InvalidRequest."""
    found: dict[str, Any] = {}
    for name, value in wanted.items():
        if name not in NAMES:
            raise InvalidRequest(f"there is no limit {name[:80]!r}; there are {', '.join(NAMES)}", field=name[:80])
        try:
            meant = _value(name, value) if isinstance(value, str) else value
            found[name] = None if value in (None, "") else msgspec.convert(meant, NAMES[name], strict=False)
        except (msgspec.ValidationError, ValueError) as error:
            raise InvalidRequest(f"{name}={str(value)[:80]}: {error}", field=name) from None
    return found


def _value(name: str, text: str) -> Any:
    if isinstance(getattr(UNLIMITED, name), list):
        return [item for item in text.split(",") if item]
    amount = quantities.number(text)
    return text if amount is None else amount


def with_changes(policy: Policy, changes: dict[str, Any]) -> Policy:
    """A policy with some fields changed; None, and keys that this version does not know, are left out."""
    known = {name: value for name, value in changes.items() if name in Policy.__struct_fields__ and value is not None}
    return replace(policy, **known)


def _check_image(policy: Policy, image: str) -> None:
    if image and not is_allowed(image, policy.images):
        raise LimitExceeded(
            f"image {image[:80]} is not among those that you may use: {', '.join(policy.images) or 'none'}",
            field="containerData.image",
            asked=image[:80],
            allowed=policy.images,
        )


def _grant(name: str, asked: float, ceiling: float, default: float) -> Any:
    _check(name, asked, ceiling)
    value = asked or default
    return min(value, ceiling) if value and ceiling else value or ceiling


def _check(name: str, asked: float, ceiling: float) -> None:
    if ceiling and asked > ceiling:
        raise LimitExceeded(
            f"{name} {_said(asked)} is more than an environment of yours may have: {_said(ceiling)}",
            field=f"containerData.{name}",
            asked=asked,
            limit=ceiling,
        )


def _check_total(name: str, total: float, limit: float, whose: str, field: str = "containerData") -> None:
    if limit and total > limit:
        raise LimitExceeded(
            f"{name}: {_said(total)} with this one; {whose} may have {_said(limit)}",
            field=field,
            asked=total,
            limit=limit,
        )


def _said(amount: float) -> str:
    return f"{amount:.0f}" if float(amount).is_integer() else f"{amount:g}"

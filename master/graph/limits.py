"""Limits of users: maximum and default of each environment's resources, and totals over all that a user has.

The platform's limits are settings of the Master. Changes for one user are kept in the database and replace them.
"""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase
from typing import Annotated, Any

import msgspec
from msgspec import UNSET, Meta, Struct
from msgspec.structs import replace

from master.graph import packages
from master.graph.records import EnvironmentOptions, IoRates
from master.graph.state import State, cores, memory
from rce.api import egress, quantities
from rce.api.egress import Egress
from rce.api.views import UsageView
from rce.errors import InvalidRequest, LimitExceeded
from rce.protocol.slots import LEAST_PIDS
from rce.spelling import did_you_mean

Number = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Cores = Annotated[float, Meta(ge=0)]
Some = Annotated[int, Meta(gt=0, le=2**63 - 1)]
SomeCores = Annotated[float, Meta(gt=0)]
NO_LIMIT = "-"
IMAGES = ("rce/base", "rce/mapping", "rce/mapping3d")  # what `provisioning/provision image` builds
_AMOUNTS = ("cpu", "memory", "pids", "disk", "bandwidth")  # each has a default and a maximum


class Policy(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of one user; None is no limit. Sizes are in bytes, rates in bytes a second."""

    # maximum of one environment, and its value where neither the user nor a default gives one
    size: Number | None = None
    cpu: Cores | None = None
    memory: Number | None = None
    pids: Number | None = None
    disk: Number | None = None
    bandwidth: Number | None = None
    io: Number | None = None
    gpus: Number | None = None

    # defaults; None: in proportion to the slots (rce.protocol.slots), or no limit of rates
    default_cpu: SomeCores | None = None
    default_memory: Some | None = None
    default_pids: Some | None = None
    default_disk: Some | None = None
    default_bandwidth: Some | None = None
    default_io: Some | None = None

    # network access of environments, beside their group
    egress: Egress = "none"

    # images beside those of all users; a name without a tag allows all of its tags, `*` matches any characters
    images: list[str] = []

    # totals of the user
    environments: Number | None = None
    cores: Cores | None = None
    total_memory: Number | None = None
    total_bandwidth: Number | None = None
    robots: Number | None = None
    connections: Number | None = None
    package_bytes: Number | None = None

    # total of the user's recordings on each machine
    recording_bytes: Number | None = None


UNLIMITED = Policy()
NAMES = {field.name: field.type for field in msgspec.structs.fields(Policy)}


def granted(policy: Policy, options: EnvironmentOptions) -> EnvironmentOptions:
    """Return the options of an environment after defaults and limits were applied.

    Raises:
        LimitExceeded: A value is above its maximum; the error has the numbers.
        InvalidRequest: The number of processes is less than an environment itself needs.
    """
    _check_image(policy, options.image)
    _check("size", options.size, policy.size)
    _check("gpus", options.gpus, policy.gpus)
    # The total of bandwidths needs a number for each environment, so it bounds the single one too.
    policy = replace(policy, bandwidth=_least(policy.bandwidth, policy.total_bandwidth))
    got = {
        name: _grant(name, getattr(options, name), getattr(policy, name), getattr(policy, f"default_{name}"))
        for name in _AMOUNTS
    }
    if 0 < got["pids"] < LEAST_PIDS:
        raise InvalidRequest(
            f"pids {got['pids']}: an environment needs at least {LEAST_PIDS} processes and threads, more with nodes",
            field="containerData.pids",
        )
    rates = IoRates(
        _grant("io.read", options.io.read, policy.io, policy.default_io),
        _grant("io.write", options.io.write, policy.io, policy.default_io),
    )
    return replace(options, io=rates, **got)


def check_totals(state: State, user: str, policy: Policy, options: EnvironmentOptions) -> None:
    """Check the user's totals with one more environment.

    Raises:
        LimitExceeded: A total is above its limit; the error has the numbers.
    """
    has = usage(state, user)
    subject = "all of your environments together"
    _check_total("environments", has.environments + 1, policy.environments, "you")
    _check_total("cores", has.cores + cores(options), policy.cores, subject)
    _check_total("total_memory", has.total_memory + memory(options), policy.total_memory, subject)
    _check_total("total_bandwidth", has.total_bandwidth + options.bandwidth, policy.total_bandwidth, subject)


def usage(state: State, user: str) -> UsageView:
    """Return what a user has of everything that totals limit."""
    environments = state.environments
    return UsageView(
        environments=environments.count(user),
        cores=environments.total(user, "cores"),
        total_memory=int(environments.total(user, "memory")),
        total_bandwidth=int(environments.total(user, "bandwidth")),
        robots=state.robots_of_user(user),
        connections=state.connections_of_user(user),
        package_bytes=packages.usage(state, user),
    )


def _least(*limits: int | None) -> int | None:
    """Return the smallest of some limits, of which None is no limit."""
    return min((each for each in limits if each is not None), default=None)


def check_robots(state: State, user: str, policy: Policy) -> None:
    """Check that a user may have one more robot.

    Raises:
        LimitExceeded: The user has all robots that the policy allows.
    """
    _check_total("robots", state.robots_of_user(user) + 1, policy.robots, "you", "robotID")


def check_connections(state: State, user: str, policy: Policy, more: int = 1) -> None:
    """Check that a user may have `more` connections.

    Raises:
        LimitExceeded: The user has all connections that the policy allows.
    """
    _check_total("connections", state.connections_of_user(user) + more, policy.connections, "you", "tagA")


def is_allowed(image: str, patterns: Iterable[str]) -> bool:
    """Return whether a pattern matches `image`, with or without its tag."""
    name = image.rpartition(":")[0] if ":" in image.rpartition("/")[2] else image
    return any(fnmatchcase(image, pattern) or fnmatchcase(name, pattern) for pattern in patterns)


def parse(assignments: Iterable[str]) -> dict[str, Any]:
    """Parse assignments such as `memory=2Gi`, `images=rce/base,mine/*` or `cpu=` into fields of a Policy.

    The value is None for `-`, which is no limit, and UNSET for an empty text, which resets a limit.

    Raises:
        InvalidRequest: An assignment is malformed or names no limit.
    """
    found: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise InvalidRequest(f"{assignment!r}: write key=value; keys are {', '.join(NAMES)}", field=name)
        found[name] = text
    return changes(found)


def changes(wanted: dict[str, Any]) -> dict[str, Any]:
    """Return fields of a Policy from values or from text as people write it.

    None and `-` stand for no limit. Empty text resets a limit to the platform's: its value is UNSET.

    Raises:
        InvalidRequest: There is no such limit, or the value does not fit.
    """
    found: dict[str, Any] = {}
    for name, value in wanted.items():
        if name not in NAMES:
            hint = did_you_mean(name, NAMES) or f"there are {', '.join(NAMES)}"
            raise InvalidRequest(f"there is no limit {name[:80]!r}: {hint}", field=name[:80])
        try:
            meant = _value(name, value) if isinstance(value, str) else value
            found[name] = UNSET if value == "" else msgspec.convert(meant, NAMES[name], strict=isinstance(meant, bool))
        except (msgspec.ValidationError, ValueError):
            raise InvalidRequest(f"{name}={str(value)[:80]}: write {_form(name)}", field=name) from None
    return found


def _form(name: str) -> str:
    """Return how the value of a limit is written."""
    if name == "egress":
        return egress.WORDS
    if name == "images":
        return "names of images with commas between them"
    kind = NAMES[name]
    number = "number" if kind in (Cores | None, SomeCores | None) else "whole number"
    least = " above 0" if kind in (Some | None, SomeCores | None) else ""
    return f"a {number}{least}, also with a unit as in 2k or 512MiB, or {NO_LIMIT} for no limit"


def _value(name: str, text: str) -> Any:
    if text == NO_LIMIT:
        return None
    if isinstance(getattr(UNLIMITED, name), list):
        return [item for item in text.split(",") if item]
    amount = quantities.parse_number(text)
    return text if amount is None else amount


def with_changes(policy: Policy, changes: dict[str, Any]) -> Policy:
    """Return a policy with some fields changed, ignoring UNSET and fields that this version does not know."""
    known = {name: value for name, value in changes.items() if name in Policy.__struct_fields__ and value is not UNSET}
    return replace(policy, **known)


def _check_image(policy: Policy, image: str) -> None:
    if image and not is_allowed(image, policy.images):
        raise LimitExceeded(
            f"image {image[:80]} is not among those that you may use: {', '.join(policy.images) or 'none'}",
            field="containerData.image",
            asked=image[:80],
            allowed=policy.images,
        )


def _grant(name: str, asked: float, maximum: float | None, default: float | None) -> Any:
    _check(name, asked, maximum)
    if maximum is None:
        return asked or default or 0
    if not maximum:
        raise LimitExceeded(
            f"{name}: an environment of yours may have 0, and none can do without",
            field=f"containerData.{name}",
            limit=0,
        )
    return min(asked or default or maximum, maximum)


def _check(name: str, asked: float, maximum: float | None) -> None:
    if maximum is not None and asked > maximum:
        raise LimitExceeded(
            f"{name} {_amount(asked)} is more than an environment of yours may have: {_amount(maximum)}",
            field=f"containerData.{name}",
            asked=asked,
            limit=maximum,
        )


def _check_total(name: str, total: float, limit: float | None, subject: str, field: str = "containerData") -> None:
    if limit is not None and total > limit:
        raise LimitExceeded(
            f"{name}: {_amount(total)} with this one; {subject} may have {_amount(limit)}",
            field=field,
            asked=total,
            limit=limit,
        )


def _amount(amount: float) -> str:
    return f"{amount:.0f}" if float(amount).is_integer() else f"{amount:g}"

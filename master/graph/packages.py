"""Users' own ROS packages: their versions, who may use them, and the space that they take.

A package has a name, unique among its user's, and versions: digests of archives, the newest last. It is private until
its user shares it. `master.storage.depot` keeps the archives.
"""

from __future__ import annotations

import re
import time

from msgspec.structs import replace

from master.graph.records import Package, Version, user_of
from master.graph.state import State
from rce.errors import InvalidRequest, LimitExceeded, NotFound
from rce.protocol.names import check_tag

EVERYBODY = "*"
MOST_VERSIONS = 100
MOST_IN_ENVIRONMENT = 50
_REFERENCE = re.compile(r"(?:([^/@]+)/)?([^/@]+)(?:@([0-9a-f]{8,64}))?", re.ASCII)


def visible(state: State, user: str) -> list[Package]:
    """Return the packages that a user may use: own ones and those that others share."""
    found = {each.name: each for term in (user, f">{user}", f">{EVERYBODY}") for each in state.packages.by(term)}
    return list(found.values())


def resolve(state: State, user: str, reference: str) -> Version:
    """Return the version that `name`, `user/name` or either with `@digest` refers to.

    Raises:
        InvalidRequest: The reference is malformed or ambiguous.
        NotFound: There is no such package or version, or the user may not use it.
    """
    match = _REFERENCE.fullmatch(reference)
    if match is None:
        raise InvalidRequest(f"package {reference[:80]!r}: write it as name, user/name or user/name@version")
    owner, name, wanted = match[1] or user, match[2], match[3] or ""
    package = state.packages.get(f"{owner}/{name}")
    if package is None or not {user, EVERYBODY} & {owner, *package.shared}:
        raise NotFound(f"there is no package {owner}/{name} that you may use; `rce package list` shows which there are")
    versions = [version for version in package.versions if version.digest.startswith(wanted)]
    if not versions:
        raise NotFound(f"package {package.name} has no version {wanted}")
    if wanted and len(versions) > 1:
        raise InvalidRequest(f"version {wanted} of package {package.name} is not one but {len(versions)}: say more")
    return versions[-1]


def resolve_all(state: State, user: str, references: list[str]) -> list[str]:
    """Return the digests for `packages` of containerData, in its order, each once."""
    field = "containerData.packages"
    if len(references) > MOST_IN_ENVIRONMENT:
        raise LimitExceeded(
            f"{len(references)} packages are more than an environment may have: {MOST_IN_ENVIRONMENT}",
            field=field,
            asked=len(references),
            limit=MOST_IN_ENVIRONMENT,
        )
    try:
        return list(dict.fromkeys(resolve(state, user, reference).digest for reference in references))
    except InvalidRequest as error:
        raise InvalidRequest(str(error), field=field) from None
    except NotFound as error:
        raise NotFound(str(error), field=field) from None


def usage(state: State, user: str) -> int:
    """Return the size of a user's archives in bytes."""
    sizes = {version.digest: version.size for package in state.packages.by(user) for version in package.versions}
    return sum(sizes.values())


def check_quota(state: State, user: str, digest: str, size: int, quota: int | None, reserved: int = 0) -> None:
    """Check that an archive of `size` bytes fits into the quota, beside what is used and `reserved`.

    Raises:
        LimitExceeded: The sum is above `quota` bytes (None: no limit).
    """
    used = usage(state, user) + reserved
    if quota is not None and find(state, user, digest) is None and used + size > quota:
        raise LimitExceeded(
            f"your packages take {used} bytes, with this one {used + size}; you may have {quota}: remove some, or "
            "versions that are not needed any more (`rce package remove NAME@VERSION`)",
            field="package_bytes",
            asked=used + size,
            limit=quota,
        )


def find(state: State, user: str, digest: str) -> Version | None:
    """Return an archive that a user has already, or None."""
    own = (version for package in state.packages.by(user) for version in package.versions)
    return next((version for version in own if version.digest == digest), None)


def add(state: State, user: str, name: str, version: Version) -> Package:
    """Add an archive as the newest version of a package, and the package if it is new.

    Raises:
        LimitExceeded: The package has too many versions.
    """
    key = f"{user}/{check_tag(name, 'name')}"
    package = state.packages.get(key) or Package(key)
    older = [each for each in package.versions if each.digest != version.digest]
    if len(older) >= MOST_VERSIONS:
        raise LimitExceeded(
            f"package {key} has {len(older)} versions, the most there may be: remove some", limit=MOST_VERSIONS
        )
    package = replace(package, versions=[*older, replace(version, created=time.time())])
    state.packages.put(package)
    return package


def share(state: State, user: str, name: str, others: list[str]) -> Package:
    """Share a package with further users (`*`: everybody)."""
    package = own(state, user, name)
    package = replace(package, shared=sorted({*package.shared, *others} - {user}))
    state.packages.put(package)
    return package


def unshare(state: State, user: str, name: str, others: list[str]) -> Package:
    """Stop sharing a package with `others`, or with everybody if empty. Running environments keep it."""
    package = own(state, user, name)
    package = replace(package, shared=sorted(set(package.shared) - set(others or package.shared)))
    state.packages.put(package)
    return package


def remove(state: State, user: str, name: str, version: str = "") -> None:
    """Remove a package, or one version of it. Running environments keep it."""
    package = own(state, user, name)
    gone = resolve(state, user, f"{name}@{version}").digest if version else ""
    left = [each for each in package.versions if version and each.digest != gone]
    if left:
        state.packages.put(replace(package, versions=left))
    else:
        state.packages.drop(package.name)


def own(state: State, user: str, name: str) -> Package:
    """Return a package of the user's own.

    Raises:
        NotFound: The user has no package of this name.
    """
    package = state.packages.get(f"{user}/{name}")
    if package is None:
        raise NotFound(f"you have no package {name[:80]!r}", field="name")
    return package


def named(state: State) -> set[str]:
    """Return the digests to keep: those of all packages, and those that environments use."""
    kept = {version.digest for package in state.packages for version in package.versions}
    kept.update(*(offer.packages for offer in state.offers))
    return kept.union(*(environment.packages for environment in state.environments))


def drop_strays(state: State, users: set[str]) -> None:
    """Remove the packages of removed users and their shares: a later user of the same name must not inherit them."""
    for package in state.packages:
        shared = [user for user in package.shared if user in {*users, EVERYBODY}]
        if user_of(package.name) not in users:
            state.packages.drop(package.name)
        elif shared != package.shared:
            state.packages.put(replace(package, shared=shared))

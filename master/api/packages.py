"""`/api/v1/packages`: users' own ROS packages. An upload is announced, then sent with the ticket; see master.depot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from master import packages
from master.api.acting import acting, cut
from master.api.calls import Answer, Call, Paging
from master.api.router import Api, Route
from master.depot import UPLOAD_PATH, Announced, Depot, Upload
from master.records import Package, Version
from master.service import Master
from rce.archive import MAX_BYTES
from rce.errors import NotFound, Unauthorized
from rce.messages import Tag
from rce.names import check_tag
from rce.views import Page

MOST_SHARES = 1000


class Announcement(Struct, frozen=True, forbid_unknown_fields=True):
    """What will be pushed: the SHA-256 of the archive in hex, and its size in bytes."""

    name: Tag
    digest: Annotated[str, Meta(extra_json_schema={"pattern": "^[0-9a-f]{64}$"})]
    size: Annotated[int, Meta(extra_json_schema={"minimum": 1, "maximum": MAX_BYTES})]


class Invitation(Struct, frozen=True):
    """Where the archive goes by PUT, with the token as bearer's; both empty if it is there already."""

    upload: str = ""
    token: str = ""


class Shares(Struct, frozen=True, forbid_unknown_fields=True):
    """Users to share with; `*` is everybody."""

    users: Annotated[list[str], Meta(min_length=1, max_length=MOST_SHARES)]


class Shown(Struct, frozen=True):
    """A package as it is listed; `shared` is told to its user alone."""

    name: str
    versions: list[Version]
    shared: list[str]


class PackagesApi:
    """The routes of packages."""

    def __init__(self, master: Master, depot: Depot) -> None:
        self._master = master
        self._depot = depot

    def add_to(self, api: Api) -> None:
        api.add(
            Route(
                *("GET", "/packages", self.list, "Packages: your own, and those shared with you"),
                query=Paging,
                answer=Page[Shown],
            ),
            Route(
                *("POST", "/packages", self.announce, "Announce an archive; its bytes go to `upload`"),
                *(None, Announcement, Invitation, 202),
            ),
            Route("DELETE", "/packages/{name}", self.remove, "Remove a package", status=204),
            Route("DELETE", "/packages/{name}/versions/{version}", self.remove, "Remove one version", status=204),
            Route("POST", "/packages/{name}/shares", self.share, "Share a package", body=Shares, answer=Shown),
            Route("DELETE", "/packages/{name}/shares", self.unshare, "Share it with nobody any more", answer=Shown),
            Route(
                "DELETE",
                "/packages/{name}/shares/{other}",
                self.unshare,
                "Share it with one user no more",
                answer=Shown,
            ),
            Route(
                "PUT", "/uploads", self.upload, "The bytes that were announced", answer=Shown, status=201, for_all=True
            ),
            Route("GET", "/archives", self.fetch, "An archive, for task sets with a ticket", answer=Path, for_all=True),
        )

    async def list(self, call: Call) -> Answer:
        acting(call, "package.read", "")
        seen = packages.visible(self._master.state, call.user)
        return cut(((each.key, _shown(each, call.user)) for each in seen), call.asked(Paging))

    async def announce(self, call: Call) -> Answer:
        acting(call, "package.push", "")
        wanted = call.body(Announcement)
        check_tag(wanted.name, "name")
        state = self._master.state
        present = packages.find(state, call.user, wanted.digest)
        if present is not None:  # only among the user's own: to know a digest is not to have the archive
            packages.add(state, call.user, wanted.name, present)
            await self._master.save()
            return Answer(Invitation())
        announced = Announced(call.user, wanted.name, wanted.digest, wanted.size)
        self._check_quota(announced, sum(each.size for each in self._depot.pending() if each.user == call.user))
        token = self._depot.announce(announced)
        return Answer(Invitation(UPLOAD_PATH, token), 202)

    async def upload(self, call: Call) -> Answer:
        upload = call.content
        if not isinstance(upload, Upload):
            raise Unauthorized("this upload was not announced, or too long ago: POST it to /api/v1/packages first")
        announced = upload.announced
        call.trail.operation, call.trail.owner, call.trail.names = "package.push", announced.user, [announced.name]
        contents = await upload.check()
        self._check_quota(announced, 0)
        version = Version(contents.digest, contents.size, contents.packages, 0)
        self._depot.keep(upload)
        package = packages.add(self._master.state, announced.user, announced.name, version)
        await self._master.save()
        return Answer(_shown(package, announced.user), 201)

    async def remove(self, call: Call) -> Answer:
        """The archive goes with the last that names it: another package, or an environment that has it still."""
        acting(call, "package.remove", "")
        packages.remove(self._master.state, call.user, call.path["name"], call.path.get("version", ""))
        await self._master.save()
        return Answer(status=204)

    async def share(self, call: Call) -> Answer:
        acting(call, "package.share", "")
        others = call.body(Shares).users
        packages.own(self._master.state, call.user, call.path["name"])
        known = {packages.EVERYBODY, *await self._master.users.names()}
        for other in others:
            if other not in known:
                raise NotFound(f"there is no user {other[:80]!r}", field="users")
        return await self._changed(packages.share(self._master.state, call.user, call.path["name"], others), call)

    async def unshare(self, call: Call) -> Answer:
        acting(call, "package.share", "")
        others = [call.path["other"]] if "other" in call.path else []
        return await self._changed(packages.unshare(self._master.state, call.user, call.path["name"], others), call)

    async def _changed(self, package: Package, call: Call) -> Answer:
        await self._master.save()
        return Answer(_shown(package, call.user))

    async def fetch(self, call: Call) -> Answer:
        """For task sets, with the ticket that the Master gave one over its control connection."""
        path = self._depot.fetch(call.token)
        if path is None:
            raise Unauthorized("the ticket is unknown, was used, or is too old")
        return Answer(path)

    def _check_quota(self, announced: Announced, reserved: int) -> None:
        user = announced.user
        quota = self._master.limits.of(user).package_bytes
        packages.check_quota(self._master.state, user, announced.digest, announced.size, quota, reserved)


def _shown(package: Package, user: str) -> Shown:
    mine = package.name.partition("/")[0] == user
    return Shown(package.name, package.versions, package.shared if mine else [])

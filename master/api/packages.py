"""`/api/v1/packages`: users' own ROS packages.

An upload is announced, then sent with the ticket in the answer; see `master.storage.depot`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from master.api.principals import authorize, page_of_views
from master.api.request import Answer, Call, PageQuery
from master.api.router import Api, Route
from master.graph import packages
from master.graph.records import Package, Version
from master.service import Master
from master.storage.depot import UPLOAD_PATH, AnnouncedUpload, Depot
from rce.api.views import Page
from rce.errors import NotFound, Unauthorized
from rce.packages.archive import MAX_BYTES
from rce.protocol.names import Tag, check_tag

MAX_SHARES = 1000


class Announcement(Struct, frozen=True, forbid_unknown_fields=True):
    """Archive to be uploaded: its SHA-256 in hex, and its size in bytes."""

    name: Tag
    digest: Annotated[str, Meta(extra_json_schema={"pattern": "^[0-9a-f]{64}$"})]
    size: Annotated[int, Meta(extra_json_schema={"minimum": 1, "maximum": MAX_BYTES})]


class UploadTicket(Struct, frozen=True):
    """Path for the PUT of the archive, and the token for its Authorization (Bearer); empty if the archive is there."""

    upload: str = ""
    token: str = ""


class Shares(Struct, frozen=True, forbid_unknown_fields=True):
    """Users to share with; `*` stands for all."""

    users: Annotated[list[str], Meta(min_length=1, max_length=MAX_SHARES)]


class PackageView(Struct, frozen=True):
    """Package as it is listed; `shared` is empty for all but its owner."""

    name: str
    versions: list[Version]
    shared: list[str]


class PackagesApi:
    """Routes of packages."""

    def __init__(self, master: Master, depot: Depot) -> None:
        self._master = master
        self._depot = depot

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        api.add(
            Route(
                *("GET", "/packages", self._list, "Your packages, and those shared with you"),
                query=PageQuery,
                answer=Page[PackageView],
            ),
            Route(
                *("POST", "/packages", self._announce, "Announce an archive, to be sent to the path `upload`"),
                *(None, Announcement, UploadTicket, 202),
            ),
            Route("DELETE", "/packages/{name}", self._remove, "Remove a package", status=204),
            Route(
                "DELETE",
                "/packages/{name}/versions/{version}",
                self._remove,
                "Remove one version of a package",
                status=204,
            ),
            Route("POST", "/packages/{name}/shares", self._share, "Share a package", body=Shares, answer=PackageView),
            Route("DELETE", "/packages/{name}/shares", self._unshare, "Stop sharing a package", answer=PackageView),
            Route(
                "DELETE",
                "/packages/{name}/shares/{other}",
                self._unshare,
                "Stop sharing a package with one user",
                answer=PackageView,
            ),
            Route(
                "PUT",
                "/uploads",
                self._upload,
                "Upload an archive that was announced",
                answer=PackageView,
                status=201,
                public=True,
            ),
            Route(
                "GET",
                "/archives",
                self._fetch,
                "Download an archive: for task sets, with a ticket",
                answer=Path,
                public=True,
            ),
        )

    async def _list(self, call: Call) -> Answer:
        authorize(call, "package.read", "")
        seen = packages.visible(self._master.state, call.user)
        return page_of_views(((each.key, _view(each, call.user)) for each in seen), call.query(PageQuery))

    async def _announce(self, call: Call) -> Answer:
        authorize(call, "package.push", "")
        wanted = call.body(Announcement)
        check_tag(wanted.name, "name")
        state = self._master.state
        present = packages.find(state, call.user, wanted.digest)
        if present is not None:  # among the user's own only: knowing a digest does not prove having the archive
            packages.add(state, call.user, wanted.name, present)
            await self._master.save()
            return Answer(UploadTicket())
        announced = AnnouncedUpload(call.user, wanted.name, wanted.digest, wanted.size)
        self._check_quota(announced, sum(each.size for each in self._depot.pending() if each.user == call.user))
        token = self._depot.announce(announced)
        return Answer(UploadTicket(UPLOAD_PATH, token), 202)

    async def _upload(self, call: Call) -> Answer:
        upload = call.upload
        if upload is None:
            raise Unauthorized(
                "the upload was not announced, or its ticket has expired: POST it to /api/v1/packages first"
            )
        announced = upload.announced
        call.audit.operation, call.audit.owner, call.audit.names = "package.push", announced.user, [announced.name]
        contents = await upload.check()
        await self._depot.store(upload)
        if announced.time <= self._master.state.removed_users.get(announced.user, 0.0):
            raise Unauthorized("the user who announced the upload was removed")
        self._check_quota(announced, 0)
        version = Version(contents.digest, contents.size, contents.packages, 0)
        self._depot.keep(upload)
        package = packages.add(self._master.state, announced.user, announced.name, version)
        await self._master.save()
        return Answer(_view(package, announced.user), 201)

    async def _remove(self, call: Call) -> Answer:
        """Remove a package or a version. The archive stays while another package or an environment uses it."""
        authorize(call, "package.remove", "")
        packages.remove(self._master.state, call.user, call.path["name"], call.path.get("version", ""))
        await self._master.save()
        return Answer(status=204)

    async def _share(self, call: Call) -> Answer:
        authorize(call, "package.share", "")
        others = call.body(Shares).users
        packages.own(self._master.state, call.user, call.path["name"])
        known = {packages.EVERYBODY, *await self._master.users.names()}
        for other in others:
            if other not in known:
                raise NotFound(f"there is no user {other[:80]!r}", field="users")
        return await self._changed(packages.share(self._master.state, call.user, call.path["name"], others), call)

    async def _unshare(self, call: Call) -> Answer:
        authorize(call, "package.share", "")
        others = [call.path["other"]] if "other" in call.path else []
        return await self._changed(packages.unshare(self._master.state, call.user, call.path["name"], others), call)

    async def _changed(self, package: Package, call: Call) -> Answer:
        await self._master.save()
        return Answer(_view(package, call.user))

    async def _fetch(self, call: Call) -> Answer:
        """Answer with the archive of a ticket, which a task set gets over its control connection."""
        path = self._depot.fetch(call.token)
        if path is None:
            raise Unauthorized("the ticket is unknown, was used or has expired")
        return Answer(path)

    def _check_quota(self, announced: AnnouncedUpload, reserved: int) -> None:
        user = announced.user
        quota = self._master.limits.of(user).package_bytes
        packages.check_quota(self._master.state, user, announced.digest, announced.size, quota, reserved)


def _view(package: Package, user: str) -> PackageView:
    owned = package.name.partition("/")[0] == user
    return PackageView(package.name, package.versions, package.shared if owned else [])

"""RoboEarth's services, answered by the knowledge service. Without ROS."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass

import yaml

from rce.api.knowledge import PREFIX, EntryChange, Kind, NewEntry
from rce.api.knowledge_requests import AddEntry, ChangeEntry, Found, RemoveEntry, RemoveFile
from rce.client.environment_knowledge import EnvironmentKnowledge
from rce.errors import AlreadyExists, InvalidRequest, NotFound, RceError

MAP, META = "map.pgm", "map.yaml"  # files of an environment with a map in the plane


@dataclass(frozen=True)
class Item:
    """Entry as RoboEarth's clients see it.

    Attributes:
        uid: Its uid.
        text: OWL text of the newest version.
        files: Names of its files.
        urls: Addresses of its files, below that of the platform.
    """

    uid: str
    text: str
    files: list[str]
    urls: list[str]


class Repository:
    """Operations of the original's node. What is written is public, as all was there."""

    def __init__(self, knowledge: EnvironmentKnowledge) -> None:
        """Use a client."""
        self._knowledge = knowledge

    def get(self, kind: Kind, uid: str) -> Item:
        """Return an entry; raise NotFound."""
        return self._item(kind, self._knowledge.find(kind, uid))

    def search(self, kind: Kind, prefix: str) -> list[Item]:
        """Return the first entries whose uids begin with a prefix."""
        return [self._item(kind, found) for found in self._knowledge.search(kind, prefix)]

    def query(self, query: str) -> str:
        """Return the answer to a query in SeRQL, as JSON with `variables` and `rows`."""
        result = self._knowledge.query(query)
        return json.dumps({"variables": result.variables, "rows": result.rows})

    def set(self, kind: Kind, cls: str, name: str, description: str, text: str, files: dict[str, bytes]) -> None:
        """Add an entry with files, or nothing at all.

        Raises:
            AlreadyExists: There is an entry of this uid.
            RceError: It is refused.
        """
        added = self._knowledge.ask(AddEntry(NewEntry(kind, cls, name, text, description, public=True))).entries[0]
        try:
            for file, content in files.items():
                self._knowledge.put_file(kind, added.uid, file, content)
        except RceError:
            self._knowledge.ask(RemoveEntry(kind, added.uid))
            raise

    def update(self, kind: Kind, uid: str, description: str, text: str) -> None:
        """Change description and text of an entry."""
        self._knowledge.ask(ChangeEntry(kind, uid, EntryChange(owl=text, description=description)))

    def remove(self, kind: Kind, uid: str) -> None:
        """Remove an entry."""
        self._knowledge.ask(RemoveEntry(kind, uid))

    def file(self, kind: Kind, uid: str, name: str) -> bytes:
        """Return a file of an entry; raise NotFound."""
        return self._knowledge.read(kind, self._with_file(kind, uid, name), name)

    def add_file(self, kind: Kind, uid: str, name: str, content: bytes) -> None:
        """Add a file to an entry; raise AlreadyExists."""
        if name in self._knowledge.find(kind, uid).files:
            raise AlreadyExists(f"the {kind} {uid} has a file {name[:80]!r}: update it", field="filename")
        self._knowledge.put_file(kind, uid, name, content)

    def replace_file(self, kind: Kind, uid: str, name: str, content: bytes) -> None:
        """Replace a file of an entry; raise NotFound."""
        self._with_file(kind, uid, name)
        self._knowledge.put_file(kind, uid, name, content)

    def remove_file(self, kind: Kind, uid: str, name: str) -> None:
        """Remove a file from an entry; raise NotFound."""
        self._knowledge.ask(RemoveFile(kind, uid, name))

    def map(self, uid: str, name: str) -> dict[str, bytes]:
        """Return image and description of an environment's map in the plane, under the name that the client chose.

        Raises:
            NotFound: There is no such environment, or it has no such map.
            InvalidRequest: The description is not that of a map.
        """
        image, meta = self.file("environment", uid, MAP), self.file("environment", uid, META)
        try:
            described = yaml.safe_load(meta)
            described["image"] = f"{name}.pgm"
        except (yaml.YAMLError, TypeError) as error:
            raise InvalidRequest(f"{META} of {uid} describes no map: {error}", field="envUID") from None
        return {f"{name}.pgm": image, f"{name}.yaml": yaml.safe_dump(described, sort_keys=False).encode()}

    def _with_file(self, kind: Kind, uid: str, name: str) -> Found:
        found = self._knowledge.find(kind, uid)
        if name not in found.files:
            raise NotFound(f"the {kind} {uid} has no file {name[:80]!r}", field="filename")
        return found

    def _item(self, kind: Kind, found: Found) -> Item:
        text = self._knowledge.read(kind, found).decode()
        return Item(found.uid, text, found.files, list(_urls(kind, found)))


def _urls(kind: Kind, found: Found) -> Iterable[str]:
    return (f"{PREFIX}/entries/{kind}/{found.uid}/files/{file}" for file in found.files)

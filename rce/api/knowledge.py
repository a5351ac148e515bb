"""Types of the knowledge service's HTTP API: entries, their versions and files, changes and queries.

The OpenAPI document is generated from these types. Times are seconds since 1970, sizes bytes, latitudes and longitudes
degrees (WGS 84), distances metres.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from msgspec import UNSET, Meta, Struct, UnsetType, field

PREFIX = "/knowledge-service"
MAX_OWL = 4 * 1024 * 1024  # characters of an OWL text

Kind = Literal["recipe", "object", "environment"]
KINDS: tuple[Kind, ...] = get_args(Kind)
Action = Literal["added", "changed", "removed"]
Language = Literal["sparql", "serql"]

# In Python, `$` alone also matches before a newline at the end.
Name = Annotated[str, Meta(min_length=1, max_length=120, pattern=r"^[A-Za-z0-9_ .-]+$(?!\n)")]
ClassName = Annotated[str, Meta(min_length=1, max_length=120, pattern=r"^[A-Za-z0-9_ -]+$(?!\n)")]
User = Annotated[str, Meta(min_length=1, max_length=120)]
Description = Annotated[str, Meta(max_length=4000)]
Owl = Annotated[str, Meta(max_length=MAX_OWL, description="RDF/XML or Turtle; may be empty")]
Readers = Annotated[list[User], Meta(max_length=100, description="users who may read it, beside its author")]
Latitude = Annotated[float, Meta(ge=-90, le=90)]
Longitude = Annotated[float, Meta(ge=-180, le=180)]


class Location(Struct, frozen=True, forbid_unknown_fields=True):
    """Place on earth."""

    latitude: Latitude
    longitude: Longitude


class NewEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """Entry to add. Its uid is `class.id` in lower case without blanks."""

    kind: Kind
    cls: Annotated[ClassName, Meta(description="class of the thing, such as `cabinet`")] = field(name="class")
    id: Annotated[Name, Meta(description="name within its class")]
    owl: Owl = ""
    description: Description = ""
    public: Annotated[bool, Meta(description="readable for all users of the platform")] = False
    shared: Readers = []
    location: Location | None = None


class EntryChange(Struct, frozen=True, forbid_unknown_fields=True):
    """Changes of an entry; what is absent stays. Another text or description is a new version."""

    owl: Owl | UnsetType = UNSET
    description: Description | UnsetType = UNSET
    public: bool | UnsetType = UNSET
    shared: Readers | UnsetType = UNSET
    location: Location | UnsetType | None = UNSET


class StoredFile(Struct, frozen=True):
    """File of a version, such as a model, a picture or a map."""

    name: str
    size: int
    sha256: str


class Entry(Struct, frozen=True):
    """Action recipe, object or environment, as its newest version has it. `shared` is empty for who does not own it."""

    kind: Kind
    uid: str
    description: str
    author: str
    version: int
    created: float
    modified: float
    modified_by: str
    rating: float
    public: bool
    shared: list[str] = []
    location: Location | None = None
    files: list[StoredFile] = []


class EntryPage(Struct, frozen=True):
    """Entries in the order of kind and uid; `next` is the `after` of the next page, empty on the last."""

    items: list[Entry]
    next: str


class Version(Struct, frozen=True):
    """State of an entry after one change. `size` is that of the OWL text."""

    number: int
    time: float
    author: str
    description: str
    size: int
    files: list[StoredFile] = []


class Change(Struct, frozen=True):
    """Change of an entry. `number` increases with each change of the repository."""

    number: int
    time: float
    action: Action
    kind: Kind
    uid: str
    version: int
    user: str


class Rating(Struct, frozen=True, forbid_unknown_fields=True):
    """Rating by a reader. The entry's rating moves by a tenth of the difference towards it."""

    rating: Annotated[float, Meta(ge=0, le=10)]


class QueryRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """Query over the newest versions of all entries that the client may read, each of which is a named graph."""

    query: Annotated[str, Meta(min_length=1, max_length=20_000)]
    language: Annotated[Language, Meta(description="`serql` in the shape that RoboEarth's clients send")] = "sparql"


class QueryResult(Struct, frozen=True):
    """Answer to a query.

    Attributes:
        variables: Names of the columns, for SELECT; `subject`, `predicate`, `object` for CONSTRUCT and DESCRIBE.
        rows: Values in the order of `variables`; IRIs and literals as in N-Triples, null without a value.
        answer: Answer to ASK.
    """

    variables: list[str] = []
    rows: list[list[str | None]] = []
    answer: bool | None = None


class Usage(Struct, frozen=True):
    """Use of the quota by a user's own entries. Contents that several versions of an entry have count once."""

    entries: int
    bytes: int
    limit: int


class Imported(Struct, frozen=True):
    """Result of an import: uids that were added, and those that exist here and stayed as they are."""

    added: int
    skipped: list[str]

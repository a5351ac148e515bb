"""Registry of message, service and action types: those of the common packages, and those that environments add.

The common messages come from the type store of rosbags. It has no services and no `map_msgs`; their definitions are
text files in `definitions` (the public interfaces of ROS 2 Kilted).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache, partial
from importlib.resources import files
from typing import NamedTuple

from rosbags.typesys import Stores, get_typestore

from converters.codec import Codec, Recipe
from converters.definition import Definition, from_rosbags, parse_action, parse_message, parse_service
from converters.dialect import Dialect
from converters.images import ImageFormat
from converters.model import Lookup, Models
from converters.reader import Readers
from converters.writer import Writers
from rce.control.calls.robots import Sort
from rce.errors import AlreadyExists, InvalidRequest, UnknownType
from rce.protocol.names import TypeName, parse_type

ACTION_PARTS = ("_Goal", "_Result", "_Feedback")


class ServiceCodec(NamedTuple):
    """Codecs of a service type."""

    request: Codec
    response: Codec


class ActionCodec(NamedTuple):
    """Codecs of an action type."""

    goal: Codec
    result: Codec
    feedback: Codec


class TypeRegistry:
    """Types by name. The common ones are shared by all registries and cannot be redefined; added ones are its own."""

    def __init__(self) -> None:
        self._added: dict[str, Definition] = {}
        self._codecs = _CodecCache(partial(_definition, self._added))  # a method would make a reference cycle

    def add(self, definitions: Mapping[str, str]) -> None:
        """Add types, all of them or, in case of an error, none.

        A type that is known with the same fields is skipped. A definition may refer to types that are added later.

        Args:
            definitions: Content of the definition file by type name (`pkg/msg/Name`, `pkg/srv/Name` or
                `pkg/action/Name`).

        Raises:
            InvalidRequest: A name or definition is malformed.
            AlreadyExists: A type is known with other fields.
        """
        new: dict[str, Definition] = {}
        for name, text in definitions.items():
            new |= _definitions(name, text)
        for name, definition in new.items():
            known = common_definitions().get(name, self._added.get(name))
            if known is not None and _fields(known) != _fields(definition):
                raise AlreadyExists(
                    f"{name} is known with other fields: {_summary(known)}, now {_summary(definition)}; "
                    "rename one of them",
                    field=name,
                )
        self._added |= {name: new[name] for name in new.keys() - common_definitions().keys() - self._added.keys()}

    def message(self, name: TypeName, image_format: ImageFormat = "png", dialect: Dialect = "plain") -> Codec:
        """Return the codec of a message type.

        Args:
            name: Type.
            image_format: Format in which the codec produces images.
            dialect: Form of what the codec reads and writes; only the dialects `plain` and `original` have pictures.

        Raises:
            UnknownType: The type, or one that it contains, is not known.
        """
        return self._codec(name.msg, image_format, dialect)

    def service(self, name: TypeName, image_format: ImageFormat = "png", dialect: Dialect = "plain") -> ServiceCodec:
        """Return the codecs of a service type; see `message`."""
        request, response = (self._codec(name.srv + part, image_format, dialect) for part in ("_Request", "_Response"))
        return ServiceCodec(request, response)

    def action(self, name: TypeName, dialect: Dialect = "plain") -> ActionCodec:
        """Return the codecs of an action type; raises UnknownType."""
        goal, result, feedback = (self._codec(name.action + part, "png", dialect) for part in ACTION_PARTS)
        return ActionCodec(goal, result, feedback)

    def definitions(self, name: TypeName, sort: Sort) -> dict[str, Definition]:
        """Return the definitions of a type, or of the parts of a service or action, and of the types in them, by name.

        Raises:
            UnknownType: The type, or one that it contains, is not known.
        """
        parts = {
            "msg": [name.msg],
            "srv": [name.srv + part for part in ("_Request", "_Response")],
            "action": [name.action + part for part in ACTION_PARTS],
        }
        found, rest = dict[str, Definition](), parts[sort]
        while rest:
            each = rest.pop()
            if each not in found:
                found[each] = _definition(self._added, each)
                rest += (field.type.base for field in found[each] if field.type.nested)
        return found

    @staticmethod
    def codec_of(recipe: Recipe) -> Codec:
        """Make the codec of a recipe."""
        registry = TypeRegistry()
        registry._added.update(recipe.added)
        return registry._codec(recipe.name, recipe.image_format, recipe.dialect)

    def _codec(self, name: str, image_format: ImageFormat, dialect: Dialect) -> Codec:
        codecs = _common_codecs() if name in common_definitions() else self._codecs
        return codecs.get(name, "json" if dialect in ("rosbridge", "cbor") else image_format, dialect)


class _CodecCache:
    """Codecs of one set of definitions, compiled on first use."""

    def __init__(self, lookup: Lookup) -> None:
        self._lookup = lookup
        self._models = {stamped: Models(lookup, stamped=stamped) for stamped in (False, True)}
        self._writers = {stamped: Writers() for stamped in (False, True)}
        self._readers: dict[tuple[ImageFormat, Dialect], Readers] = {}
        self._codecs: dict[tuple[str, ImageFormat, Dialect], Codec] = {}

    def get(self, name: str, image_format: ImageFormat, dialect: Dialect) -> Codec:
        key = name, image_format, dialect
        if key not in self._codecs:
            stamped = dialect in ("rosbridge", "cbor")
            readers = self._readers.setdefault(key[1:], Readers(image_format, dialect=dialect))
            recipe = Recipe(name, image_format, tuple(_added(name, self._lookup)), dialect)
            self._codecs[key] = Codec(self._models[stamped].message(name), self._writers[stamped], readers, recipe)
        return self._codecs[key]


def _added(name: str, lookup: Lookup) -> Iterator[tuple[str, Definition]]:
    """Yield the definitions of a type, and of those that it contains, which are not common."""
    found, rest = set[str](), [name]
    while rest:
        each = rest.pop()
        if each not in found and each not in common_definitions():
            found.add(each)
            definition = lookup(each)
            rest += (field.type.base for field in definition if field.type.nested)
            yield each, definition


def _definition(added: Mapping[str, Definition], name: str) -> Definition:
    return _find(name, common_definitions() if name in common_definitions() else added)


def _find(name: str, definitions: Mapping[str, Definition]) -> Definition:
    if name not in definitions:
        raise UnknownType(
            f"unknown type {name}: correct the name, or start an environment that has the type", field="className"
        )
    return definitions[name]


@cache
def _common_codecs() -> _CodecCache:
    return _CodecCache(lambda name: _find(name, common_definitions()))


@cache
def common_definitions() -> Mapping[str, Definition]:
    """Return the definitions of all types of the common packages."""
    store = get_typestore(Stores.ROS2_KILTED)
    definitions = {name: from_rosbags(name, fields) for name, (_, fields) in store.fielddefs.items()}
    for name, text in _definition_files():
        definitions |= _definitions(name, text)
    return definitions


def _definition_files() -> Iterator[tuple[str, str]]:
    for package in files("converters").joinpath("definitions").iterdir():
        for kind in package.iterdir():
            for file in kind.iterdir():
                yield f"{package.name}/{kind.name}/{file.name.partition('.')[0]}", file.read_text("utf-8")


def _definitions(name: str, text: str) -> dict[str, Definition]:
    """Parse a definition file into its messages: one, two of a service, or three of an action."""
    parsed = parse_type(name)
    if name == parsed.msg:
        return {name: parse_message(name, text)}
    if name == parsed.action:
        parts = zip(ACTION_PARTS, parse_action(name, text), strict=True)
        return {name + part: definition for part, definition in parts}
    if name != parsed.srv:
        raise InvalidRequest(f"{name} is ambiguous: write pkg/msg/Name, pkg/srv/Name or pkg/action/Name", field=name)
    request, response = parse_service(name, text)
    return {name + "_Request": request, name + "_Response": response}


def _fields(definition: Definition) -> list[tuple[str, object]]:
    """Return the parts of a definition that determine the serialized form."""
    return [(field.name, field.type) for field in definition]


def _summary(definition: Definition) -> str:
    return ", ".join(f"{field.name} ({field.type.base})" for field in definition)[:300] or "none"

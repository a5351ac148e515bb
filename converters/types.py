"""The message and service types that the platform knows: those of the common packages, and what environments teach it.

The messages come from rosbags' type store; its services and `map_msgs`, which it lacks, stand as text in `definitions`
(facts of the public interfaces of ROS 2 Kilted).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from rosbags.typesys import Stores, get_typestore

from converters.codec import Codec
from converters.definition import Definition, from_rosbags, parse_message, parse_service
from converters.images import ImageFormat
from converters.model import Lookup, Models
from converters.reader import Readers
from converters.writer import Writers
from rce.errors import AlreadyExists, InvalidRequest, UnknownType
from rce.names import TypeName, parse_type


class ServiceCodec(NamedTuple):
    request: Codec
    response: Codec


class TypeRegistry:
    """Types by name. Common ones are shared by all registries and cannot be redefined; learnt ones are its own."""

    def __init__(self) -> None:
        self._learnt: dict[str, Definition] = {}
        self._workshop = _Workshop(self._definition)

    def learn(self, definitions: Mapping[str, str]) -> None:
        """Add `pkg/msg/Name` or `pkg/srv/Name` by the text of its file; what is known already in the same form is fine.

        All or nothing. InvalidRequest if a name or text is malformed, AlreadyExists if a type is known with other
        fields. A definition may refer to types that are learnt later.
        """
        new: dict[str, Definition] = {}
        for name, text in definitions.items():
            new |= _definitions(name, text)
        for name, definition in new.items():
            known = common_definitions().get(name, self._learnt.get(name))
            if known is not None and _shape(known) != _shape(definition):
                raise AlreadyExists(
                    f"{name} is known with other fields: {_shown(known)}, now {_shown(definition)}; rename one of them",
                    field=name,
                )
        self._learnt |= {name: new[name] for name in new.keys() - common_definitions().keys() - self._learnt.keys()}

    def message(self, name: TypeName, image_format: ImageFormat = "png") -> Codec:
        """The codec of a message type; `image_format` is how images leave. UnknownType if it is not known."""
        return self._codec(name.msg, image_format)

    def service(self, name: TypeName, image_format: ImageFormat = "png") -> ServiceCodec:
        """The codecs of a service type. UnknownType if it is not known."""
        request, response = (self._codec(name.srv + part, image_format) for part in ("_Request", "_Response"))
        return ServiceCodec(request, response)

    def _codec(self, name: str, image_format: ImageFormat) -> Codec:
        workshop = _common_workshop() if name in common_definitions() else self._workshop
        return workshop.codec(name, image_format)

    def _definition(self, name: str) -> Definition:
        return _find(name, common_definitions() if name in common_definitions() else self._learnt)


class _Workshop:
    """Compiles codecs and keeps them."""

    def __init__(self, lookup: Lookup) -> None:
        self._models = Models(lookup)
        self._writers = Writers()
        self._readers: dict[ImageFormat, Readers] = {}
        self._codecs: dict[tuple[str, ImageFormat], Codec] = {}

    def codec(self, name: str, image_format: ImageFormat) -> Codec:
        key = name, image_format
        if key not in self._codecs:
            readers = self._readers.setdefault(image_format, Readers(image_format))
            self._codecs[key] = Codec(self._models.message(name), self._writers, readers, image_format)
        return self._codecs[key]


def _find(name: str, definitions: Mapping[str, Definition]) -> Definition:
    if name not in definitions:
        raise UnknownType(
            f"the type {name} is not known: start an environment that has it, or correct the name", field="className"
        )
    return definitions[name]


@cache
def _common_workshop() -> _Workshop:
    return _Workshop(lambda name: _find(name, common_definitions()))


@cache
def common_definitions() -> Mapping[str, Definition]:
    """All types of the common packages."""
    store = get_typestore(Stores.ROS2_KILTED)
    found = {name: from_rosbags(name, fields) for name, (_, fields) in store.fielddefs.items()}
    for name, text in _shipped():
        found |= _definitions(name, text)
    return found


def _shipped() -> Iterator[tuple[str, str]]:
    for package in files("converters").joinpath("definitions").iterdir():
        for kind in package.iterdir():
            for file in kind.iterdir():
                yield f"{package.name}/{kind.name}/{file.name.partition('.')[0]}", file.read_text("utf-8")


def _definitions(name: str, text: str) -> dict[str, Definition]:
    """The messages that a definition file defines: one, or a service's request and response."""
    parsed = parse_type(name)
    if name == parsed.msg:
        return {name: parse_message(name, text)}
    if name != parsed.srv:
        raise InvalidRequest(f"{name} may be a message or a service: write pkg/msg/Name or pkg/srv/Name", field=name)
    request, response = parse_service(name, text)
    return {name + "_Request": request, name + "_Response": response}


def _shape(definition: Definition) -> list[tuple[str, object]]:
    """What of a definition matters on the wire."""
    return [(field.name, field.type) for field in definition]


def _shown(definition: Definition) -> str:
    return ", ".join(f"{field.name} ({field.type.base})" for field in definition)[:300] or "none"

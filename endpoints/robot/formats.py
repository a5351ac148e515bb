"""Formats of interfaces: which codec converts between the robot's form of a message and CDR."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Literal, NoReturn

import msgspec
from msgspec import Struct

from converters import Codec as JsonCodec
from converters import Recipe, Wire
from converters.cdr import CDR, CdrCodec
from converters.custom_files import Description
from converters.dialect import Dialect
from converters.reduction import ALL, ReducedCodec
from converters.reduction import AnyCodec as Codec
from converters.ros1 import ROS1, Ros1Codec
from endpoints.robot.session import RobotSession
from rce.codecs.names import check, is_series
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import ConversionError, InvalidRequest, RceError
from rce.protocol.blobs import Buffer
from rce.protocol.messages import IMAGE_FORMATS
from rce.protocol.names import parse_type

ENCAPSULATIONS = (b"\0\0", b"\0\1")  # CDR, big and little endian
DEFAULT = "png"  # of interfaces that name no format
FOREIGN = ("rosbridge", "cbor")  # dialects that an interface has by its format

Codecs = Callable[[], Codec]
"""Returns the codec for the present features of the robot."""


class PassThroughCodec(CdrCodec):
    """Codec of Forwarders, for which the blob of a message is its CDR.

    Other bytes reach the Forwarders of other robots, as with the original, but nobody else; the robot is told once.
    """

    def __init__(self, tag: str, report: Callable[[RceError], None]) -> None:
        super().__init__(Recipe("", "json"))  # for no worker
        self._tag = tag
        self._report = report
        self._reported = False

    def encode(self, wire: Wire) -> Buffer:
        """Return the blob of a message; raise InvalidRequest if it is not exactly one blob."""
        blob = super().encode(wire)
        if not self._reported and (len(blob) < 4 or bytes(blob[:2]) not in ENCAPSULATIONS):
            self._reported = True
            self._report(
                ConversionError(
                    f"interface {self._tag}: the blob is not CDR, the serialized form of ROS 2: it begins with "
                    f"{bytes(blob[:4]).hex()!r}. Only Forwarders of other robots get it. If it is ROS 1, add the "
                    "interface with the format ros1; if it is compressed, set gzip_lvl to 0",
                    field="msg",
                )
            )
        return blob


class WorkerCodec:
    """Codec that only the workers have: a user's converter or one of packets, which run nowhere else."""

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe

    def encodes_fast(self, wire: Wire) -> bool:
        """Return False: nobody knows how long it takes."""
        return False

    def decodes_fast(self, cdr: Buffer) -> bool:
        """Return False: nobody knows how long it takes."""
        return False

    def encode(self, wire: Wire) -> NoReturn:
        """Fail: a worker does this."""
        raise NotImplementedError

    def decode(self, cdr: Buffer) -> NoReturn:
        """Fail: a worker does this."""
        raise NotImplementedError


class Formats(Struct, frozen=True):
    """Formats that this endpoint has.

    Attributes:
        custom: Converters of users.
        original_forwarders: What Forwarders of robots without features carry.
    """

    custom: Sequence[Description] = ()
    original_forwarders: Literal["cdr", "ros1"] = "cdr"

    def codecs(self, spec: InterfaceSpec, session: RobotSession, codec: Callable[[Dialect], JsonCodec]) -> Codecs:
        """Return the codec of an interface as a function, because the features of a session may change when it resumes.

        A robot without features is a client of the original and gets its JSON.

        Args:
            spec: The interface.
            session: The robot's session.
            codec: Returns the type's codec in a dialect; raises UnknownType.

        Raises:
            InvalidRequest: There is no such format for this interface.
            UnknownType: The type is not known, and its messages are converted.
        """
        forms = _packed(spec, codec) if spec.codec else self._forms(spec, session, codec)
        return _reduced(spec, codec, forms) if spec.delivery.fields or spec.delivery.decimate != ALL else forms

    def _forms(self, spec: InterfaceSpec, session: RobotSession, codec: Callable[[Dialect], JsonCodec]) -> Codecs:
        if spec.kind.endswith("Forwarder"):
            return self._of_forwarder(spec, session, codec)
        if spec.format in FOREIGN:
            foreign = codec(spec.format)  # type: ignore[arg-type]
            return lambda: foreign
        custom = self._custom(spec)
        if custom is not None:
            by_worker = WorkerCodec(msgspec.structs.replace(codec("plain").recipe, converter=custom))
            return lambda: by_worker
        if spec.format not in IMAGE_FORMATS:
            known = sorted({each.name for each in self.custom if each.type == parse_type(spec.type).msg})
            raise InvalidRequest(
                f"there is no format {spec.format[:40]!r} for {spec.type[:80]}: "
                f"a {spec.kind[:40]} has {', '.join((*IMAGE_FORMATS, *FOREIGN, *known))}",
                field="format",
            )
        plain, original = codec("plain"), cache(partial(codec, "original"))
        return lambda: plain if session.features else original()

    def _of_forwarder(
        self, spec: InterfaceSpec, session: RobotSession, codec: Callable[[Dialect], JsonCodec]
    ) -> Codecs:
        if spec.format not in (*IMAGE_FORMATS, "cdr", ROS1):
            raise InvalidRequest(
                f"there is no format {spec.format[:40]!r} for a {spec.kind}: it has cdr and ros1", field="format"
            )
        plain = PassThroughCodec(spec.tag, session.error)
        by_default = self.original_forwarders == ROS1 and spec.format != "cdr" and not session.features
        if spec.format != ROS1 and not by_default:
            return lambda: plain
        ros1 = Ros1Codec(codec("plain"))
        return lambda: ros1 if spec.format == ROS1 or not session.features else plain

    def _custom(self, spec: InterfaceSpec) -> str | None:
        """Return the name of the user's converter that an interface uses."""
        if spec.kind not in ("PublisherConverter", "SubscriberConverter"):
            return None
        fitting = [each for each in self.custom if each.type == parse_type(spec.type).msg]
        return next((e.name for e in fitting if e.name == spec.format or (e.default and spec.format == DEFAULT)), None)


def _packed(spec: InterfaceSpec, codec: Callable[[Dialect], JsonCodec]) -> Codecs:
    """Return the codec of packets, which only the workers have; raise InvalidRequest if there is none for the type."""
    receives = spec.kind.startswith("Publisher")
    check(spec.codec, spec.type, receives=receives)
    if spec.delivery.fields:
        raise InvalidRequest("a packet has no fields: leave out delivery.fields, or the codec", field="delivery.fields")
    series = is_series(spec.codec, spec.type)
    stream = spec.id if series and not receives else ""  # those to robots get theirs from the encoder, which they share
    recipe = msgspec.structs.replace(codec("plain").recipe, codec=spec.codec, stream=stream)
    by_worker = WorkerCodec(recipe)
    return lambda: by_worker


def _reduced(spec: InterfaceSpec, codec: Callable[[Dialect], JsonCodec], forms: Codecs) -> Codecs:
    """Return codecs that make messages smaller first; raise InvalidRequest if the type has no such parts."""
    made: dict[int, tuple[Codec, Codec]] = {}  # by identity of the form: features decide which one is used

    def find() -> Codec:
        form = forms()
        if id(form) not in made:
            made[id(form)] = form, _make_reduced(spec, codec, form)
        return made[id(form)][1]

    find()
    return find


def _make_reduced(spec: InterfaceSpec, codec: Callable[[Dialect], JsonCodec], form: Codec) -> Codec:
    plain = codec("plain")
    if isinstance(form, PassThroughCodec):
        form = CdrCodec(msgspec.structs.replace(plain.recipe, converter=CDR))
    delivery, base = spec.delivery, form if isinstance(form, JsonCodec) else plain
    return ReducedCodec(base, form, delivery.fields, delivery.decimate)

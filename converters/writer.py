"""Writers from decoded JSON (`model.Message.model`) to CDR; each type is compiled once into a chain of closures.

A closure appends its bytes to a list and returns the position after them, so large payloads are copied only once, when
the list is joined. Values out of range are detected by `struct`; only then are they converted one by one (`scalars`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter

import msgspec

from converters.definition import Shape
from converters.images import read_picture
from converters.layout import Item, Leaf, Run, layout
from converters.model import IMAGE, Message
from converters.scalars import PACK_ERRORS, FieldError, TimeValue, Value, packable, time_value
from converters.wire import Buffer, Incoming
from converters.writer_items import Source, Write, getter, primitive, start

MAX_CDR = 1 << 26  # a list of empty objects is short in JSON but can be long in CDR
PADDING = tuple(bytes(n) for n in range(8))


class Writers:
    """Compiled writers of one set of messages."""

    def __init__(self) -> None:
        self._nested: dict[str, Write] = {}

    def top(self, message: Message) -> Write:
        """Return the writer of a message at the beginning of the buffer."""
        return _chain([self._step(step) for step in layout(message, top=True)])

    def nested(self, message: Message) -> Write:
        """Return the writer of a message at any position."""
        if message.name not in self._nested:
            steps = [self._step(step) for step in layout(message, top=False)]
            self._nested[message.name] = _chain(steps)
        return self._nested[message.name]

    def _step(self, step: Run | Item) -> Write:
        if isinstance(step, Run):
            return _run(step)
        kind = step.member.type
        if step.member.message is None:
            return primitive(step)
        write = self.nested(step.member.message)
        get = getter(step, image_source(step.member.message) if kind.base == IMAGE else None)
        return _one(get, write, step.path) if kind.shape is Shape.SINGLE else _many(get, write, step)


def image_source(image: Message) -> Callable[[Buffer], msgspec.Struct]:
    """Return a function that decodes a PNG or JPEG file into the model of sensor_msgs/Image."""
    header = image.members[0].message
    if header is None:
        raise TypeError(f"{image.name} has no header")
    new_image, new_header = image.model, header.model

    def decode(blob: Buffer) -> msgspec.Struct:
        picture = read_picture(blob)
        stamp = TimeValue(*picture.stamp)
        order = (picture.height, picture.width, picture.encoding, int(picture.is_bigendian), picture.step, picture.data)
        return new_image(new_header(stamp, picture.frame_id), *order)

    return decode


def _chain(steps: list[Write]) -> Write:
    if len(steps) == 1:
        return steps[0]

    def write(source: Source, parts: list[Buffer], pos: int, blobs: Incoming) -> int:
        for step in steps:
            pos = step(source, parts, pos, blobs)
        return pos

    return write


def _run(run: Run) -> Write:
    mask, pack, size = run.mask, run.struct.pack, run.struct.size
    if not run.leaves:
        return _filler(pack())
    get = attrgetter(*(".".join(leaf.attrs) for leaf in run.leaves))
    values = get if len(run.leaves) > 1 else lambda source: (get(source),)

    def write(source: Source, parts: list[Buffer], pos: int, blobs: Incoming) -> int:
        if padding := -pos & mask:
            parts.append(PADDING[padding])
        try:
            parts.append(pack(*values(source)))
        except (AttributeError, *PACK_ERRORS):  # AttributeError: a time in its short form has no f0
            parts.append(pack(*[_packable_scalar(source, leaf) for leaf in run.leaves]))
        return pos + padding + size

    return write


def _filler(data: bytes) -> Write:
    def write(source: Source, parts: list[Buffer], pos: int, blobs: Incoming) -> int:
        parts.append(data)
        return pos + len(data)

    return write


def _packable_scalar(source: Source, leaf: Leaf) -> Value:
    """Return a scalar of the message, converted so that it can be packed; raises FieldError."""
    value: Source = source
    path = leaf.path.rpartition(".")[0]  # path of the time or duration, for errors in its short form
    try:
        for attr in leaf.attrs:
            value = getattr(time_value(value) if isinstance(value, str | int | float) else value, attr)
        path = leaf.path
        return packable(value, leaf.code)  # type: ignore[arg-type]
    except FieldError as error:
        raise error.inside(path) from None


def _one(get: Callable[[Source, Incoming], object], nested: Write, path: str) -> Write:
    def write(source: Source, parts: list[Buffer], pos: int, blobs: Incoming) -> int:
        value = get(source, blobs)
        try:
            return nested(value, parts, pos, blobs)  # type: ignore[arg-type]
        except FieldError as error:
            raise error.inside(path) from None

    return write


def _many(get: Callable[[Source, Incoming], object], nested: Write, item: Item) -> Write:
    kind, path = item.member.type, item.path

    def write(source: Source, parts: list[Buffer], pos: int, blobs: Incoming) -> int:
        values: Sequence[Source] = get(source, blobs)  # type: ignore[assignment]
        pos = start(kind, values, parts, pos, path)
        for i, value in enumerate(values):
            try:
                pos = nested(value, parts, pos, blobs)
            except FieldError as error:
                raise error.inside(f"{path}[{i}]") from None
            if pos > MAX_CDR:
                raise FieldError(f"the message is larger than {MAX_CDR} bytes in CDR", path)
        return pos

    return write

"""Options in the query of a client's URL, because the protocol has no fields for them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec import Struct

from converters.decimation import CLOUD, SCAN
from endpoints.gateways.foxglove.packets import TYPES
from endpoints.robot.handshake import Request, optional
from rce.codecs.names import IMAGE, check
from rce.errors import InvalidRequest
from rce.protocol.messages import Delivery
from rce.protocol.names import parse_type

REDUCED = (IMAGE, CLOUD, SCAN)
"""Types that have a rate and fewer parts; of others, such as transforms, every message counts."""
SIZE = re.compile(r"([0-9]{1,5})x([0-9]{1,5})")


class Options(Struct, frozen=True):
    """Options that a client has chosen for its channels.

    Attributes:
        deliveries: Delivery of the messages of a type, by its name.
        codecs: Codecs for which topics get an additional channel.
    """

    deliveries: Mapping[str, Delivery] = {}
    codecs: tuple[str, ...] = ()

    def delivery(self, type: str) -> Delivery:
        """Return the delivery of the messages of a type."""
        return self.deliveries.get(parse_type(type).msg, Delivery())


def parse(request: Request) -> Options:
    """Return the options of a request: `rate`, `step`, `size` (`640x480`) and `codec` (`draco,h264`).

    Raises:
        InvalidRequest: An option has no such value, or this endpoint lacks a codec.
    """
    step = optional(request, "step") or "1"
    delivery = {"rate": optional(request, "rate") or "0", "decimate": {"step": step}}
    deliveries = dict.fromkeys(REDUCED, delivery)
    if size := optional(request, "size"):
        found = SIZE.fullmatch(size)
        if found is None:
            raise InvalidRequest(f"size is {size[:40]!r}: write WIDTHxHEIGHT, as 640x480", field="size")
        deliveries[IMAGE] = delivery | {"decimate": {"step": step, "size": found.groups()}}
    codecs = tuple(filter(None, ",".join(map(str, request.params.get("codec", []))).split(",")))
    for codec in codecs:
        if codec not in TYPES:
            raise InvalidRequest(f"there is no codec {codec[:40]!r} for viewers: {', '.join(TYPES)}", field="codec")
        check(codec, TYPES[codec][0])
    return Options({type: _delivery(each) for type, each in deliveries.items()}, codecs)


def _delivery(fields: Mapping[str, Any]) -> Delivery:
    try:
        return msgspec.convert(fields, Delivery, strict=False)
    except msgspec.ValidationError as error:
        raise InvalidRequest(f"options of the URL: {error}") from None

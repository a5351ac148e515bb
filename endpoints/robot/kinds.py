"""The kinds of a robot's interfaces: makes the interface that a command describes."""

from __future__ import annotations

from typing import Literal, cast

from converters import TypeRegistry
from endpoints.data.hops import HopRecorder
from endpoints.robot.actions import ActionClient, ActionCodecs, ActionProvider
from endpoints.robot.formats import Formats
from endpoints.robot.interfaces import Publisher, RobotInterface, Subscriber
from endpoints.robot.services import ServiceClient, ServiceProvider
from endpoints.robot.session import RobotSession
from endpoints.robot.video import SharedEncoders, VideoPublisher
from endpoints.robot.workers import Workers
from rce.codecs.names import is_series
from rce.control.calls.endpoints import InterfaceSpec
from rce.protocol.messages import IMAGE_FORMATS
from rce.protocol.names import parse_type


def make_interface(
    spec: InterfaceSpec,
    hops: HopRecorder,
    session: RobotSession,
    workers: Workers,
    types: TypeRegistry,
    timeout: float,
    formats: Formats,
    encoders: SharedEncoders,
) -> RobotInterface:
    """Create an interface of the kind that `spec` names.

    Args:
        spec: The interface.
        hops: Recorder of the endpoint's hops.
        session: Session of the robot.
        workers: Workers for messages whose conversion takes long.
        types: Types that the robot's user has.
        timeout: Seconds until a service call fails.
        formats: Formats of this endpoint.
        encoders: Encoders of video of this endpoint.

    Raises:
        InvalidRequest: There is no such format or codec for this interface.
        UnknownType: The type is not known, and its messages are converted.
    """
    prefix = spec.kind.removesuffix("Converter").removesuffix("Forwarder")
    name = parse_type(spec.type)
    if prefix in ("Publisher", "Subscriber"):
        image = cast(Literal["png", "jpeg", "json"], spec.format if spec.format in IMAGE_FORMATS else "json")
        codec = formats.codecs(spec, session, lambda dialect: types.message(name, image, dialect))
        if prefix == "Publisher" and is_series(spec.codec, spec.type):
            return VideoPublisher(spec, hops, session, workers, codec, encoders)
        return (Publisher if prefix == "Publisher" else Subscriber)(spec, hops, session, workers, codec)
    if prefix in ("ActionClient", "ActionProvider"):
        goal = formats.codecs(spec, session, lambda dialect: types.action(name, dialect).goal)
        result = formats.codecs(spec, session, lambda dialect: types.action(name, dialect).result)
        feedback = formats.codecs(spec, session, lambda dialect: types.action(name, dialect).feedback)
        action = ActionClient if prefix == "ActionClient" else ActionProvider
        return action(spec, hops, session, workers, ActionCodecs(goal, result, feedback))
    request = formats.codecs(spec, session, lambda dialect: types.service(name, dialect=dialect).request)
    response = formats.codecs(spec, session, lambda dialect: types.service(name, dialect=dialect).response)
    kind = ServiceClient if prefix == "ServiceClient" else ServiceProvider
    return kind(spec, hops, session, workers, request, response, timeout)

"""JSON and blobs of robots to ROS 2 messages (CDR) and back, with no ROS installed."""

from converters.codec import Codec
from converters.images import ImageFormat
from converters.types import ServiceCodec, TypeRegistry
from converters.wire import Wire

__all__ = ["Codec", "ImageFormat", "ServiceCodec", "TypeRegistry", "Wire"]

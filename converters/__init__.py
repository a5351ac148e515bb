"""Conversion between the JSON and blobs of robots and serialized ROS 2 messages (CDR), without a ROS installation.

This package knows message definitions, their CDR layout and image files; it knows nothing of connections or endpoints.
"""

from converters.codec import Codec, Recipe
from converters.custom import Converter
from converters.images import ImageFormat
from converters.types import ActionCodec, ServiceCodec, TypeRegistry
from converters.wire import Wire

__all__ = ["ActionCodec", "Codec", "Converter", "ImageFormat", "Recipe", "ServiceCodec", "TypeRegistry", "Wire"]

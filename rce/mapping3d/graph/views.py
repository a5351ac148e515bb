"""Key frames prepared for alignment, the most recently used in memory."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property

from rce.mapping3d.frames import KeyFrame
from rce.mapping3d.graph.store import KeyFrameStore
from rce.mapping3d.odometry.pyramid import Level, ReferenceLevel, image_pyramid, reference_pyramid
from rce.mapping3d.places.features import Features, find_features

MAX_VIEWS = 40  # in memory, about 2 MB each at QVGA


@dataclass(frozen=True)
class View:
    """A key frame with what alignment and recognition need of it, computed when first used.

    Attributes:
        key: The key frame.
    """

    key: KeyFrame

    @cached_property
    def image(self) -> list[Level]:
        """The image at all sizes."""
        return image_pyramid(self.key.frame, self.key.camera)

    @cached_property
    def reference(self) -> list[ReferenceLevel]:
        """The points of the image at all sizes."""
        return reference_pyramid(self.image)

    @cached_property
    def features(self) -> Features:
        """The features of the image."""
        return find_features(self.key.frame, self.key.camera)


class Views:
    """Views by number of the key frame, read from the store where they are not in memory."""

    def __init__(self, store: KeyFrameStore) -> None:
        """Begin without views in memory."""
        self._store = store
        self._recent: OrderedDict[int, View] = OrderedDict()

    def add(self, number: int, key: KeyFrame) -> View:
        """Return the view of a key frame that was just stored."""
        self._recent[number] = view = View(key)
        while len(self._recent) > MAX_VIEWS:
            self._recent.popitem(last=False)
        return view

    def __getitem__(self, number: int) -> View:
        if number in self._recent:
            self._recent.move_to_end(number)
            return self._recent[number]
        return self.add(number, self._store.key_frame(number))

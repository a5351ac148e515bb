"""Index of key frames by their features: which of them look like an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.places.features import DESCRIPTOR_BYTES, Features

TABLES = 8
WORD_BITS = 20  # of a descriptor, at random places for each table
COMMON = 0.2  # share of the entries; a word in more of them says nothing
SEED = 1


class PlaceIndex:
    """Inverted index over words of binary descriptors.

    A word is a choice of bits of a descriptor (locality-sensitive hashing: Indyk and Motwani, Approximate Nearest
    Neighbors, 1998), so there is no vocabulary to train. Rare words count more (Sivic and Zisserman, Video Google,
    2003). Each entry takes about 20 kB.
    """

    def __init__(self) -> None:
        """Create an empty index."""
        random = np.random.default_rng(SEED)
        self._bits = np.stack([random.permutation(8 * DESCRIPTOR_BYTES)[:WORD_BITS] for _ in range(TABLES)])
        self._entries: dict[int, list[int]] = {}  # by word: numbers of key frames
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, number: int, features: Features) -> None:
        """Add a key frame."""
        self._count += 1
        for word in self._words(features).tolist():
            self._entries.setdefault(word, []).append(number)

    def query(self, features: Features) -> list[tuple[int, float]]:
        """Return the key frames that share words with an image, and the sums of their weights, best first."""
        scores: dict[int, float] = {}
        most = max(5.0, COMMON * self._count)
        for word in self._words(features).tolist():
            numbers = self._entries.get(word)
            if not numbers or len(numbers) > most:
                continue
            weight = float(np.log(1.0 + self._count / len(numbers)))
            for number in numbers:
                scores[number] = scores.get(number, 0.0) + weight
        return sorted(scores.items(), key=lambda each: -each[1])

    def _words(self, features: Features) -> NDArray[np.int64]:
        """Return the distinct words of descriptors; the table is part of a word."""
        if not len(features):
            return np.empty(0, np.int64)
        bits = np.unpackbits(features.descriptors, axis=1)
        powers = np.int64(1) << np.arange(WORD_BITS, dtype=np.int64)
        words = [
            bits[:, chosen].astype(np.int64) @ powers + (np.int64(table) << WORD_BITS)
            for table, chosen in enumerate(self._bits)
        ]
        return np.unique(np.concatenate(words))

"""Encoded images as they travel."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Packet:
    """One encoded image.

    Attributes:
        number: Place in the sequence of this encoder, from 0; a gap tells the decoder that a packet was dropped.
        key: Whether it can be decoded without those before it.
        data: The encoded image.
    """

    number: int
    key: bool
    data: bytes

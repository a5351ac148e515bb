"""Process that converts messages for a Robot endpoint: `python -P -m endpoints.robot.worker DESCRIPTOR PATH`.

It converts what it reads from its socket, one request at a time, until the endpoint closes the other end. Pictures and
JSON of strangers are decoded here: a decoder that crashes, or takes all memory, costs one message. So does a converter
of a user; PATH is that of such converters, or empty.

A request and its answer are each a head as msgpack, followed by buffers:

    number of buffers 4 | size 8 of the head and each buffer | head | buffers   (big-endian)
"""

from __future__ import annotations

import os
import resource
import signal
import socket
import struct
import sys
from collections.abc import Sequence
from functools import cache, lru_cache

import cv2
import msgspec
from msgspec import Struct

from converters import Codec, Converter, Recipe, TypeRegistry, Wire, custom_files
from converters.cdr import CDR, CdrCodec
from converters.custom import CustomCodec
from converters.custom_files import Description
from converters.packed import PackedCodec
from converters.reduction import ALL, AnyCodec, ReducedCodec
from converters.ros1 import ROS1, Ros1Codec
from rce.errors import ErrorInfo, LimitExceeded, RceError
from rce.process.malloc import keep_large_blocks
from rce.protocol.blobs import Buffer
from rce.protocol.buffers import uninitialized

MAX_MEMORY = 2 << 30  # bytes of data of one worker
NICENESS = 10  # small messages, which the endpoint converts itself, come first
MAX_CODECS = 1000
MAX_STREAMS = 32  # of video, whose encoders hold several images each
COUNT, SIZE = struct.Struct("!I"), struct.Struct("!Q")


class Encode(Struct, frozen=True, tag=True):
    """Request to convert JSON and blobs to CDR; its buffers are the JSON and the blobs."""

    recipe: Recipe
    is_blob: bool
    blobs: list[str]  # their ids


class Decode(Struct, frozen=True, tag=True):
    """Request to convert CDR to JSON and blobs; its buffer is the CDR. With `key`, a packet of video is a key frame."""

    recipe: Recipe
    key: bool = False


class Describe(Struct, frozen=True, tag=True):
    """Request for the users' converters."""


class Described(Struct, frozen=True, tag=True):
    """Answer: the users' converters."""

    converters: list[Description]


class Converted(Struct, frozen=True, tag=True):
    """Answer: CDR in one buffer, or JSON and blobs in several."""

    is_blob: bool = False
    blobs: list[str] = []  # their ids


class Failed(Struct, frozen=True, tag=True):
    """Answer: the message cannot be converted."""

    error: ErrorInfo


Request = Encode | Decode | Describe
Answer = Converted | Described | Failed


def send(sock: socket.socket, head: Request | Answer, buffers: Sequence[Buffer]) -> None:
    """Write a request or an answer."""
    encoded = msgspec.msgpack.encode(head)
    sizes = [SIZE.pack(len(each)) for each in (encoded, *buffers)]
    sock.sendall(b"".join((COUNT.pack(len(buffers)), *sizes, encoded)))
    for each in buffers:
        sock.sendall(each)


def receive(sock: socket.socket) -> tuple[bytes, list[bytes]]:
    """Read the head and the buffers of a request or an answer.

    Raises:
        EOFError: The other end has closed the socket.
    """
    (count,) = COUNT.unpack(_read(sock, COUNT.size))
    sizes = [size for (size,) in SIZE.iter_unpack(_read(sock, SIZE.size * (count + 1)))]
    head, *buffers = (_read(sock, size) for size in sizes)
    return head, buffers


def _read(sock: socket.socket, size: int) -> bytes:
    content, view = uninitialized(size)
    while view:
        count = sock.recv_into(view, 0, socket.MSG_WAITALL)
        if not count:
            raise EOFError
        view = view[count:]
    return content


def _codec(recipe: Recipe, converters: str) -> AnyCodec:
    return (_stream if recipe.stream else _shared)(recipe, converters)


@lru_cache(MAX_STREAMS)
def _stream(recipe: Recipe, converters: str) -> AnyCodec:
    """Return the codec of a stream, with its state; a forgotten one begins again with a key frame."""
    return _make(recipe, converters)


@lru_cache(MAX_CODECS)
def _shared(recipe: Recipe, converters: str) -> AnyCodec:
    return _make(recipe, converters)


def _make(recipe: Recipe, converters: str) -> AnyCodec:
    codec = TypeRegistry.codec_of(recipe)
    form = _form(recipe, codec, converters)
    if recipe.fields or recipe.decimate != ALL:
        return ReducedCodec(codec, form, recipe.fields, recipe.decimate)
    return form


def _form(recipe: Recipe, codec: Codec, converters: str) -> AnyCodec:
    if recipe.codec:
        return PackedCodec(codec, recipe)
    if recipe.converter == ROS1:
        return Ros1Codec(codec)
    if recipe.converter == CDR:
        return CdrCodec(recipe)
    return CustomCodec(codec, _custom(converters)[recipe.converter]) if recipe.converter else codec


@cache
def _custom(converters: str) -> dict[str, Converter]:
    return custom_files.load(converters)


def convert(request: Request, buffers: Sequence[Buffer], converters: str = "") -> tuple[Answer, list[Buffer]]:
    """Return the answer to a request and its buffers; `converters` is the path of users' converters."""
    try:
        if isinstance(request, Describe):
            return Described(custom_files.describe(_custom(converters))), []
        codec = _codec(request.recipe, converters)
        if isinstance(request, Encode):
            raw, *blobs = buffers
            return Converted(), [codec.encode(Wire(request.is_blob, raw, dict(zip(request.blobs, blobs, strict=True))))]
        if request.key and isinstance(codec, PackedCodec | ReducedCodec):
            codec.request_key()
        wire = codec.decode(buffers[0])
        return Converted(wire.is_blob, list(wire.blobs)), [memoryview(wire.raw), *wire.blobs.values()]
    except RceError as refused:
        return Failed(refused.info), []
    except MemoryError:
        error = LimitExceeded("the conversion of this message takes too much memory: send less at a time")
        return Failed(error.info), []


def serve(sock: socket.socket, converters: str = "") -> None:
    """Answer requests until the other end closes the socket."""
    decoder: msgspec.msgpack.Decoder[Request] = msgspec.msgpack.Decoder(Request)
    while True:
        try:
            head, buffers = receive(sock)
            answer, results = convert(decoder.decode(head), buffers, converters)
            del buffers
            send(sock, answer, results)
            del results
        except (EOFError, ConnectionError):
            return


def silence_decoders() -> None:
    """Discard what libpng and libjpeg print about bad pictures: strangers could fill the log with it.

    They write to the descriptor; Python's own messages still go to standard error.
    """
    sys.stderr = os.fdopen(os.dup(2), "w", buffering=1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)


def main() -> None:
    """Run the program."""
    silence_decoders()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the endpoint, which closes the socket
    resource.setrlimit(resource.RLIMIT_DATA, (MAX_MEMORY, MAX_MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.nice(NICENESS)
    cv2.setNumThreads(1)
    keep_large_blocks()
    serve(socket.socket(fileno=int(sys.argv[1])), sys.argv[2])


if __name__ == "__main__":
    main()

"""Entry point of the command `rce`: standard streams, signals and exit statuses around `execute.run`."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys

import rce

DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
INTERRUPTED, BROKEN_PIPE = 128 + signal.SIGINT, 128 + signal.SIGPIPE  # as shells report programs ended by a signal

DEFAULT_EXTRAS = "server,mapping,mapping3d,ros,bench"
EXTRAS = {
    "prompt_toolkit": "console",
    "mcap": "bag",
    "PIL": "images",
    "av": "video",
    "DracoPy": "draco",
    "warp": "dense",
    "onnxruntime": "onnx",
    "rdflib": "knowledge",
    "pyoxigraph": "knowledge",
    "docker": "docker",
    "kubernetes_asyncio": "kubernetes",
    "psycopg": "postgresql",
}
"""Extra that brings a library, where the default extras do not, or a command needs only that."""


def main() -> int:
    """Run the command line and return the exit status.

    Returns:
        0: success. 1: failure, with the reason on standard error. 2: wrong command line. 130: Ctrl-C. 141: the reader
        of the output has exited (`rce audit | head`). Some commands have statuses of their own, as `env shell`.
    """
    _configure_streams()
    try:
        try:
            return _run(sys.argv[1:])
        finally:
            sys.stdout.flush()  # at exit, the interpreter would report an error in its own way
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        _discard_output()
        return BROKEN_PIPE
    except OSError as error:
        if error.filename is None and error.errno not in DISK_FULL:
            raise
        from rce.errors import describe_os_error

        print(f"rce: {describe_os_error(error)}", file=sys.stderr)
        _discard_output()
        return 1


def _configure_streams() -> None:
    """Print `?` for characters that the terminal's encoding lacks, and tolerate a closed standard output."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115  # for as long as the process lives


def _discard_output() -> None:
    """Drop what is still buffered, which the interpreter would try to write again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _run(words: list[str]) -> int:
    from rce.cli import execute, table  # not at the top: `main` handles a Ctrl-C during these imports

    if words[:1] in ([], ["-h"], ["--help"]) or words == ["help"]:
        print(table.overview())
        return 0
    if words == ["--version"]:
        print(f"rce {rce.__version__}")
        return 0
    try:
        return execute.run(words)
    except ModuleNotFoundError as error:  # a light installation; a missing module of RCE itself is a defect
        if error.name is None or error.name.partition(".")[0] == "rce":
            raise
        extras = EXTRAS.get(error.name.partition(".")[0], DEFAULT_EXTRAS)
        print(f"rce: this needs {error.name}: pip install '.[{extras}]' in a checkout of RCE", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())

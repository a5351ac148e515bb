"""Event loop of server processes. Each test starts a process, because a process has only one reactor."""

import asyncio
import json
import signal
import socket
import subprocess
import sys

from twisted.internet.base import ReactorBase

PROGRAM = """
import asyncio, sys
from rce.process import loop
from rce.errors import Unavailable
from twisted.internet.threads import deferToThreadPool

async def main(reactor):
    {body}

sys.exit(loop.run(main))
"""


def run(body: str) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-P", "-c", PROGRAM.format(body=body)]
    return subprocess.run(program, capture_output=True, text=True, timeout=30)


def test_reactor_and_asyncio_share_the_loop() -> None:
    ended = run(
        "called = deferToThreadPool(reactor, reactor.getThreadPool(), lambda: 42);"
        "print(await called.asFuture(asyncio.get_running_loop()))"
    )
    assert (ended.returncode, ended.stdout) == (0, "42\n"), ended.stderr


def test_rce_error_is_logged_as_one_line() -> None:
    ended = run("raise Unavailable('nobody there')")
    event = json.loads(ended.stderr)
    assert ended.returncode == 1
    assert (event["level"], event["message"], event["code"]) == ("error", "nobody there", "unavailable")


def test_unhandled_exception_is_logged_with_its_traceback() -> None:
    ended = run("1 / 0")
    event = json.loads(ended.stderr)
    assert ended.returncode == 1
    assert "ZeroDivisionError" in event["traceback"]


def test_records_of_python_logging_are_logged() -> None:
    ended = run("import logging; logging.getLogger('lib').warning('odd %d', 7); logging.getLogger('lib').debug('no')")
    event = json.loads(ended.stderr)
    assert (event["level"], event["from"], event["message"]) == ("warn", "lib", "odd 7")


def test_what_is_loaded_is_left_out_of_garbage_collection() -> None:
    """A full collection runs when a quarter of what is collected is new, so more garbage comes together otherwise."""
    ended = run("import gc; print(len(gc.get_objects()) < gc.get_freeze_count() / 4)")
    assert (ended.returncode, ended.stdout) == (0, "True\n"), ended.stderr


async def test_main_cleans_up_after_a_signal() -> None:
    body = """
    try:
        print('up', flush=True)
        await asyncio.get_running_loop().create_future()
    finally:
        await asyncio.sleep(0.01)
        print('down')
    """
    program = await asyncio.create_subprocess_exec(
        sys.executable, "-P", "-c", PROGRAM.format(body=body), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert program.stdout is not None
    assert await program.stdout.readline() == b"up\n"
    program.send_signal(signal.SIGINT)
    program.send_signal(signal.SIGTERM)
    out, _ = await asyncio.wait_for(program.communicate(), 30)
    assert (program.returncode, out) == (0, b"down\n")


async def test_reactor_of_the_tests_runs_on_their_loop(reactor: ReactorBase) -> None:
    loop = asyncio.get_running_loop()
    from_thread = loop.create_future()
    reactor.callInThread(reactor.callFromThread, from_thread.set_result, 42)
    assert await from_thread == 42
    called = loop.create_future()
    reactor.callLater(0, called.set_result, True)
    assert await called


def test_port_in_use_is_logged_as_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ended = run(
            f"from twisted.internet.protocol import Factory;reactor.listenTCP({port}, Factory(), interface='127.0.0.1')"
        )
    event = json.loads(ended.stderr)
    assert ended.returncode == 1
    assert event["message"] == (
        f"port {port} of 127.0.0.1 is in use: choose another port, or stop the program that listens on it"
    )


def test_unusable_file_is_logged_as_one_line() -> None:
    ended = run("open('/dev/null/x')")
    event = json.loads(ended.stderr)
    assert (ended.returncode, event["message"], "traceback" in event) == (1, "/dev/null/x: not a directory", False)

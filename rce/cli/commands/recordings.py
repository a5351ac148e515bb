"""`recorder`, and `bag list|get|remove|upload`: recorders of environments, and recordings that the platform keeps."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rce.api import views
from rce.cli import output
from rce.cli.arguments import ENVIRONMENT, JSON, OF_USER, argument
from rce.cli.command import Command, Group
from rce.cli.session import ConsoleSession
from rce.errors import AlreadyExists

if TYPE_CHECKING:
    from rce.client.recordings import RecordingsClient

MEGABYTE = 1_000_000
RECORDER = argument("recorder", metavar="RECORDER", help="its recorderTag")
RECORDING = argument("recording", metavar="MACHINE/ID", help="a recording, as `bag list` prints it")

RECORDERS: output.Columns[views.RecorderView] = {
    "recorder": lambda each: each.recorderTag,
    "state": lambda each: each.state,
    "topics": lambda each: each.topics or "all",
    "file size": lambda each: output.size_text(each.maxSize or None),
    "file seconds": lambda each: each.maxDuration or None,
}
RECORDINGS: output.Columns[views.RecordingView] = {
    "recording": lambda each: f"{each.machine}/{each.recording}",
    "file": lambda each: each.name,
    "state": lambda each: each.state,
    "size": lambda each: output.size_text(each.size),
    "created": lambda each: output.local_time(each.created),
    "environment": lambda each: each.containerTag,
    "recorder": lambda each: each.recorderTag,
}

GROUP = Group(
    "recorder",
    "Record topics of environments in the cloud.",
    "A recorder writes on the machine of its environment, and goes on in its later lives. `bag list` lists the "
    "recordings, `bag get` downloads one.",
)


def _recorder_add(session: ConsoleSession, args: argparse.Namespace) -> None:
    size = int(args.max_size * MEGABYTE)
    body = views.NewRecorder(args.recorder, args.topics, size, args.max_duration)
    path = ("environments", args.environment, "recorders")
    session.api.post(views.RecorderView, *path, body=body, user=args.of)


def _recorder_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    found = session.api.items(views.RecorderView, "environments", args.environment, "recorders", user=args.of)
    output.print_table(found, RECORDERS, args.json)


def _recorder_remove(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.delete("environments", args.environment, "recorders", args.recorder, user=args.of)


def _client(session: ConsoleSession) -> RecordingsClient:
    from rce.client.recordings import RecordingsClient

    access = session.access
    password = None if access.key else access.password or ""
    return RecordingsClient(access.url, user=access.user, password=password, key=access.key or None)


def _bag_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    found = _client(session).pages(args.of, args.environment)
    output.print_table(found.items, RECORDINGS, args.json)
    for machine in found.missing:
        print(f"machine {machine} is away: its recordings are missing here", file=sys.stderr)


def _bag_get(session: ConsoleSession, args: argparse.Namespace) -> None:
    client = _client(session)
    found = client.get(args.recording, args.of)
    path = args.out or Path(found.name)
    if path.exists():
        raise AlreadyExists(f"{path} exists: give another file with --out, or remove it", field="out")
    client.fetch(args.recording, path, args.of)
    print(f"{output.size_text(path.stat().st_size)} in {path}")


def _bag_remove(session: ConsoleSession, args: argparse.Namespace) -> None:
    for recording in args.recordings:
        _client(session).remove(recording, args.of)


def _bag_upload(session: ConsoleSession, args: argparse.Namespace) -> None:
    for path in args.files:
        print(_client(session).upload(path).id, flush=True)


COMMANDS = (
    Command(
        "recorder add",
        "Record topics of an environment on its machine, until the recorder is removed.",
        _recorder_add,
        (
            ENVIRONMENT,
            argument("recorder", metavar="RECORDER", help="a new recorderTag"),
            argument("topics", nargs="*", metavar="TOPIC", help="(default: all, also those that appear later)"),
            argument("--max-size", type=float, default=0, metavar="MB", help="begin another file after so many MB"),
            argument("--max-duration", type=float, default=0, metavar="S", help="begin another file after S seconds"),
            OF_USER,
        ),
        ("recorder add brain black_box", "recorder add brain lasers /scan /odom --max-size 1000"),
    ),
    Command(
        "recorder list",
        "List the recorders of an environment.",
        _recorder_list,
        (ENVIRONMENT, OF_USER, JSON),
        ("recorder list brain",),
    ),
    Command(
        "recorder remove",
        "End a recorder and complete its file; its recordings are kept.",
        _recorder_remove,
        (ENVIRONMENT, RECORDER, OF_USER),
        ("recorder remove brain black_box",),
    ),
    Command(
        "bag list",
        "List the recordings that the platform keeps, the newest first.",
        _bag_list,
        (
            argument(
                "environment", completion="environment", nargs="?", default="", metavar="ENV", help="(default: all)"
            ),
            OF_USER,
            JSON,
        ),
        ("bag list", "bag list brain --json"),
    ),
    Command(
        "bag get",
        "Download a recording, or the rest of it if an earlier download was interrupted.",
        _bag_get,
        (RECORDING, argument("-o", "--out", type=Path, metavar="FILE.mcap", help="(default: its own name)"), OF_USER),
        ("bag get beta/0f3c --out drive.mcap",),
    ),
    Command(
        "bag remove",
        "Remove recordings from the platform.",
        _bag_remove,
        (argument("recordings", nargs="+", metavar="MACHINE/ID", help="as `bag list` prints them"), OF_USER),
        ("bag remove beta/0f3c",),
    ),
    Command(
        "bag upload",
        "Upload recordings to the platform, or the rest of them after an interruption.",
        _bag_upload,
        (argument("files", nargs="+", type=Path, metavar="FILE.mcap"),),
        ("bag upload drive.mcap",),
    ),
)

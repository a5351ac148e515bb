"""`rce map submit|status|fetch|cancel`: maps by the map service of a platform."""

from __future__ import annotations

import argparse
import re
import sys
import time
from pathlib import Path

import msgspec

from rce.client.map_service import MapService
from rce.commands.platform import access, add_command, add_entry
from rce.console.show import Columns, rows, text, when
from rce.errors import InvalidRequest, NotFound, RceError
from rce.map_jobs import MAPPERS, OVER, Job, MapOptions

NAMES = ("submit", "status", "fetch", "cancel")
TICK, LINE_EVERY = 0.2, 5.0  # seconds between signs of progress on a terminal, and elsewhere
MEGABYTE = 1e6
MOST_LETTERS = 200  # of the name of an upload


def parser() -> argparse.ArgumentParser:
    whole = argparse.ArgumentParser(prog="rce map", description="Maps by the map service of a running platform.")
    commands = whole.add_subparsers(dest="command", required=True)
    submit = add_command(commands, "submit", "send recordings and have maps made of them")
    submit.add_argument("recordings", nargs="+", type=Path, metavar="FILE", help="CARMEN log, ROS 1 or ROS 2 bag")
    submit.add_argument("--mapper", choices=MAPPERS, default=MAPPERS[0], help="(default: %(default)s)")
    submit.add_argument("--resolution", type=float, default=0.05, help="metres a cell (default: %(default)s)")
    submit.add_argument("--max-range", type=float, default=30.0, help="of beams, metres (default: %(default)s)")
    submit.add_argument("--scan-topic", default="", help="of a bag with several topics of laser scans")
    submit.add_argument("--odometry-topic", default="", help="of a bag with several topics of odometry")
    submit.add_argument("--wait", action="store_true", help="wait for the maps, and fetch them")
    submit.add_argument(
        "--out", type=Path, default=Path("map"), metavar="DIR", help="for the map's files (default: %(default)s)"
    )
    status = add_command(commands, "status", "your jobs, or one of them")
    status.add_argument("job", nargs="?", metavar="JOB")
    fetch = add_command(commands, "fetch", "wait for the end of a job and fetch its files")
    fetch.add_argument("job", metavar="JOB")
    fetch.add_argument(
        "--out", type=Path, default=Path("map"), metavar="DIR", help="for the map's files (default: %(default)s)"
    )
    cancel = add_command(commands, "cancel", "end a job")
    cancel.add_argument("job", metavar="JOB")
    for command in (submit, status, cancel):
        command.add_argument("--json", action="store_true", help="print jobs as JSON")
    for command in (submit, status, fetch, cancel):
        group = command.add_argument_group("platform")
        add_entry(group)
    return whole


def main(arguments: list[str]) -> int:
    words = parser().parse_args(arguments)
    who = access(words)
    service = MapService(who.url, user=who.user, password=who.password, key=who.key)
    match words.command:
        case "submit":
            return submit(service, words)
        case "status":
            found = [service.job(words.job)] if words.job else service.jobs()
            show(found, words.json, one=bool(words.job))
        case "fetch":
            return finish(service, words.job, words.out)
        case "cancel":
            show([service.cancel(words.job)], words.json, one=True)
    return 0


def submit(service: MapService, words: argparse.Namespace) -> int:
    options = options_of(words)
    files = [files_of(recording) for recording in words.recordings]
    jobs = []
    for recording, parts in zip(words.recordings, files, strict=True):
        alone = recording.is_file()  # the files of a bag are known to each other by their names
        uploads = [send(service, part, safe(part.name) if alone else part.name) for part in parts]
        jobs.append(service.submit(uploads, options, recording.name))
        print(f"{recording}: job {jobs[-1].id}", file=sys.stderr)
    if not words.wait:
        show(jobs, words.json)
        return 0
    results = []
    for recording, job in zip(words.recordings, jobs, strict=True):
        results.append(finish(service, job.id, words.out if len(jobs) == 1 else words.out / recording.name))
    return max(results)


def options_of(words: argparse.Namespace) -> MapOptions:
    """InvalidRequest names the option at fault."""
    values = {field: getattr(words, field) for field in MapOptions.__struct_fields__}
    try:
        return msgspec.convert(values, MapOptions)
    except msgspec.ValidationError as error:
        reason, _, field = str(error).partition(" - at `$.")
        option = field.rstrip("`").replace("_", "-")
        if "regex" in reason:
            reason = "a topic begins with / and has letters, digits, _ and / only"
        raise InvalidRequest(f"rce map submit: --{option}: {reason}", field=option) from None


def files_of(recording: Path) -> list[Path]:
    """The files to send for a recording: the file itself, or those of a ROS 2 bag's directory."""
    if not recording.exists():
        raise NotFound(f"no such recording: {recording}", field="path")
    if recording.is_file():
        return [recording]
    found = sorted(path for path in recording.iterdir() if path.is_file() and not path.name.startswith("."))
    if not any(path.name == "metadata.yaml" for path in found):
        raise InvalidRequest(f"{recording} is not a ROS 2 bag: it has no metadata.yaml", field="path")
    return found


def safe(name: str) -> str:
    """A name as the service takes it."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", name).lstrip("._-")[-MOST_LETTERS:]


def send(service: MapService, path: Path, name: str) -> str:
    """Send a file under this name; the id of the upload."""
    progress = Progress(f"sending {path.name}")
    size = path.stat().st_size or 1
    began, first = time.monotonic(), -1

    def told(there: int) -> None:
        nonlocal first
        first = there if first < 0 else first
        speed = (there - first) / MEGABYTE / max(time.monotonic() - began, 1e-3)
        progress.show(f"{100 * there // size} % of {size / MEGABYTE:.1f} MB, {speed:.0f} MB/s", last=there == size)

    return service.upload(path, told, name).id


def finish(service: MapService, name: str, directory: Path) -> int:
    """Wait for the end of a job, tell how it is going, and fetch what it made; the exit status."""
    progress = Progress(f"job {name}")
    job = service.job(name)
    for job in service.watch(name):
        progress.show(describe(job), last=job.state in OVER)
    directory.mkdir(parents=True, exist_ok=True)
    for file in job.files:
        service.fetch(name, file.name, directory / file.name)
    if job.error is not None:
        raise RceError.from_info(job.error)
    what = f"{job.scans} scans mapped" if job.state == "done" else job.state
    print(f"{what}; in {directory}: {', '.join(file.name for file in job.files)}")
    return 0 if job.state == "done" else 1


def describe(job: Job) -> str:
    """A job in some words."""
    if job.state == "queued":
        return f"{job.stage}, {job.ahead} of yours first" if job.ahead else job.stage
    if job.state != "running":
        return job.state + (f": {job.error.message}" if job.error else "")
    if job.stage != "mapping":
        return job.stage
    return f"mapping, {job.scans}{f'/{job.total}' if job.total else ''} scans"


COLUMNS: Columns[Job] = {
    "job": lambda job: job.id,
    "created": lambda job: when(job.created),
    "recording": lambda job: job.recording,
    "state": describe,
}


def show(jobs: list[Job], as_json: bool, one: bool = False) -> None:
    if one and as_json:
        print(text(jobs[0]))
    else:
        rows(jobs, COLUMNS, as_json)


class Progress:
    """One line that changes where there is a terminal, else a line now and then; on standard error."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._shown = 0.0
        self._terminal = sys.stderr.isatty()

    def show(self, text: str, last: bool = False) -> None:
        now = time.monotonic()
        if not last and now - self._shown < (TICK if self._terminal else LINE_EVERY):
            return
        self._shown = now
        line = f"{self._what}: {text}"
        start, end = ("\r", "\n" if last else "") if self._terminal else ("", "\n")
        print(start + (line.ljust(79) if self._terminal else line), end=end, file=sys.stderr, flush=True)

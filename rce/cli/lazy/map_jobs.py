"""Implementation of `rce map submit|status|fetch|cancel` and `rce job list`: jobs of a platform's map service."""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec

from rce.api.map_jobs import FINAL_STATES, Job, MapOptions
from rce.cli.contexts import Access, running_platform
from rce.cli.output import Columns, local_time, print_table, to_json
from rce.cli.session import ConsoleSession
from rce.client.map_service import MapServiceClient
from rce.errors import InvalidRequest, NotFound, RceError

TERMINAL_INTERVAL, LINE_INTERVAL = 0.2, 5.0  # seconds between reports of progress on a terminal, and elsewhere
MEGABYTE = 1e6
MAX_NAME_LENGTH = 200  # of an upload


def submit(session: ConsoleSession, args: argparse.Namespace) -> int:
    """Upload recordings and submit a job for each, or one for all; with --wait also fetch the maps."""
    service = _service(running_platform(args))
    options = map_options(args)
    jobs = []
    for name, files in submissions(args.recordings, args.parallel):
        uploads = [upload(service, path, file_name) for path, file_name in files]
        jobs.append(service.submit(uploads, options, name))
        print(f"{name}: job {jobs[-1].id}", file=sys.stderr)
    if not args.wait:
        print_jobs(jobs, args.json)
        return 0
    alone = len(jobs) == 1
    return max(finish(service, job.id, args.out if alone else args.out / job.recording) for job in jobs)


def status(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Print all jobs of the user, or one of them."""
    service = _service(running_platform(args))
    jobs = [service.job(args.job)] if args.job else service.jobs()
    print_jobs(jobs, args.json, single=bool(args.job))


def fetch(session: ConsoleSession, args: argparse.Namespace) -> int:
    """Wait for the end of a job and fetch its files."""
    return finish(_service(running_platform(args)), args.job, args.out)


def cancel(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Cancel a job."""
    print_jobs([_service(running_platform(args)).cancel(args.job)], args.json, single=True)


def job_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Print all jobs of the user at the console's platform."""
    print_jobs(_service(session.access).jobs(), args.json)


def _service(access: Access) -> MapServiceClient:
    return MapServiceClient(access.url, user=access.user, password=access.password, key=access.key)


def map_options(args: argparse.Namespace) -> MapOptions:
    """Return the options of a job.

    Raises:
        InvalidRequest: A value is out of range; names the option.
    """
    values = {field: getattr(args, field) for field in MapOptions.__struct_fields__}
    try:
        return msgspec.convert(values, MapOptions)
    except msgspec.ValidationError as error:
        reason, _, field = str(error).partition(" - at `$.")
        option = field.rstrip("`").replace("_", "-")
        if "regex" in reason:
            reason = "a topic begins with / and has letters, digits, _ and / only"
        raise InvalidRequest(f"rce map submit: --{option}: {reason}", field=option) from None


def submissions(recordings: Sequence[Path], parallel: int) -> list[tuple[str, list[tuple[Path, str]]]]:
    """Return the jobs for recordings: the name of each, and its files with the names of their uploads.

    Raises:
        NotFound: A recording does not exist.
        InvalidRequest: A recording is no recording, or cannot share a job with others.
    """
    files = [files_of(recording) for recording in recordings]
    # The files of a bag refer to each other by their names.
    named = [
        [(part, upload_name(part.name) if recording.is_file() else part.name) for part in parts]
        for recording, parts in zip(recordings, files, strict=True)
    ]
    if parallel == 1 or len(recordings) == 1:
        return [(recording.name, parts) for recording, parts in zip(recordings, named, strict=True)]
    bag = next((recording for recording in recordings if recording.is_dir()), None)
    if bag is not None:
        text = f"{bag} has several files and cannot share a job with other recordings: give its .mcap or .db3 file"
        raise InvalidRequest(text, field="recordings")
    return [(f"{len(recordings)} recordings", [part for parts in named for part in parts])]


def files_of(recording: Path) -> list[Path]:
    """Return the files of a recording: the file itself, or those in the directory of a ROS 2 bag.

    Raises:
        NotFound: The path does not exist.
        InvalidRequest: The directory is not a bag's.
    """
    if not recording.exists():
        raise NotFound(f"no such recording: {recording}", field="path")
    if recording.is_file():
        return [recording]
    found = sorted(path for path in recording.iterdir() if path.is_file() and not path.name.startswith("."))
    if not any(path.name == "metadata.yaml" for path in found):
        raise InvalidRequest(f"{recording} is not a ROS 2 bag: it has no metadata.yaml", field="path")
    return found


def upload_name(name: str) -> str:
    """Return a file name with the characters replaced that the map service refuses."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", name).lstrip("._-")[-MAX_NAME_LENGTH:]


def upload(service: MapServiceClient, path: Path, name: str) -> str:
    """Upload a file under this name, with progress on standard error, and return the id of the upload."""
    progress = Progress(f"sending {path.name}")
    size = path.stat().st_size or 1
    began, first = time.monotonic(), -1

    def report(sent: int) -> None:
        nonlocal first
        first = sent if first < 0 else first  # a resumed upload does not begin at 0
        speed = (sent - first) / MEGABYTE / max(time.monotonic() - began, 1e-3)
        progress.update(f"{100 * sent // size} % of {size / MEGABYTE:.1f} MB, {speed:.0f} MB/s", last=sent == size)

    return service.upload(path, report, name).id


def finish(service: MapServiceClient, job_id: str, directory: Path) -> int:
    """Wait for the end of a job, with progress on standard error, and fetch its files.

    Returns:
        The exit status: 0 if the job is done, 1 if it was cancelled.

    Raises:
        RceError: The job failed, with the error of the job; files that it has are fetched before.
    """
    progress = Progress(f"job {job_id}")
    job = service.job(job_id)
    for job in service.watch(job_id):
        progress.update(describe(job), last=job.state in FINAL_STATES)
    directory.mkdir(parents=True, exist_ok=True)
    for file in job.files:
        service.fetch(job_id, file.name, directory / file.name)
    if job.error is not None:
        raise RceError.from_info(job.error)
    result = f"{job.scans} scans mapped" if job.state == "done" else job.state
    print(f"{result}; in {directory}: {', '.join(file.name for file in job.files)}")
    return 0 if job.state == "done" else 1


def describe(job: Job) -> str:
    """Return state and progress of a job in a few words."""
    if job.state == "queued":
        return f"{job.stage}, {job.ahead} of yours first" if job.ahead else job.stage
    if job.state != "running":
        return job.state + (f": {job.error.message}" if job.error else "")
    if job.stage != "mapping":
        return job.stage
    return f"mapping, {job.scans}{f'/{job.total}' if job.total else ''} scans"


COLUMNS: Columns[Job] = {
    "job": lambda job: job.id,
    "created": lambda job: local_time(job.created),
    "recording": lambda job: job.recording,
    "state": describe,
}


def print_jobs(jobs: list[Job], as_json: bool, single: bool = False) -> None:
    """Print a table of jobs; `single` is for a list of one, which is not a list in JSON."""
    if single and as_json:
        print(to_json(jobs[0]))
    else:
        print_table(jobs, COLUMNS, as_json)


class Progress:
    """Progress on standard error: one line that changes on a terminal, a line every few seconds elsewhere."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._printed_at = 0.0
        self._terminal = sys.stderr.isatty()

    def update(self, text: str, last: bool = False) -> None:
        """Print the state, unless it was printed a moment ago and is not the last."""
        now = time.monotonic()
        if not last and now - self._printed_at < (TERMINAL_INTERVAL if self._terminal else LINE_INTERVAL):
            return
        self._printed_at = now
        line = f"{self._label}: {text}"
        start, end = ("\r", "\n" if last else "") if self._terminal else ("", "\n")
        print(start + (line.ljust(79) if self._terminal else line), end=end, file=sys.stderr, flush=True)

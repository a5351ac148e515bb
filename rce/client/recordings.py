"""Blocking client of the platform's recordings: lists, downloads and uploads them.

Only the standard library and msgspec are needed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rce.api.map_jobs import Upload
from rce.api.views import RecordingPage, RecordingView
from rce.client.service_client import Answer
from rce.client.tus import TusClient

PAGE = 1000


class RecordingsClient(TusClient):
    """Client of the recordings of one user. All methods block, and connect anew for each request."""

    prefix = "/api/v1"
    uploads_path = "/recordings"

    def _locate(self) -> str:
        """Return the URL of the platform's entry, which serves the recordings itself."""
        return self._base

    def pages(self, user: str = "", environment: str = "") -> RecordingPage:
        """Return all recordings, of one environment if it is given, the newest first.

        Args:
            user: Owner of the recordings; empty for the client's own.
            environment: Environment of which to list them; empty for all, and uploads.
        """
        items: list[RecordingView] = []
        missing: list[str] = []
        after = ""
        while True:
            path = f"{self.uploads_path}?limit={PAGE}&after={after}&user={user}&environment={environment}"
            page = self.value(self.ask("GET", path), RecordingPage)
            items += page.items
            missing, after = page.missing, page.next
            if not after:
                return RecordingPage(sorted(items, key=lambda each: each.created, reverse=True), missing=missing)

    def uploads(self) -> list[Upload]:
        """Return the user's uploads."""
        return [_upload(view) for view in self.pages().items if view.length]

    def read_upload(self, answer: Answer) -> Upload:
        """Return the upload in an answer."""
        return _upload(self.value(answer, RecordingView))

    def get(self, recording: str, user: str = "") -> RecordingView:
        """Return a recording by its name, `machine/id`."""
        return self.value(self.ask("GET", f"{self.uploads_path}/{recording}?user={user}"), RecordingView)

    def remove(self, recording: str, user: str = "") -> None:
        """Remove a recording by its name, `machine/id`."""
        self.ask("DELETE", f"{self.uploads_path}/{recording}?user={user}")

    def fetch(
        self, recording: str, file: Path, user: str = "", progress: Callable[[int], None] = lambda _: None
    ) -> None:
        """Download a recording, or the rest of it if an earlier attempt was interrupted.

        Args:
            recording: Its name, `machine/id`.
            file: Path to store it under. It is written under a temporary name and then renamed.
            user: Owner of the recording; empty for the client's own.
            progress: Function that is called with the number of bytes that are there.
        """
        draft = file.with_name(f".{file.name}.{recording.rpartition('/')[2]}.part")
        begin = draft.stat().st_size if draft.exists() else 0
        size = self.get(recording, user).size
        if begin < size:
            path = f"{self.uploads_path}/{recording}/file?user={user}"
            with draft.open("ab") as out:
                for piece in self.pieces(path, {"Range": f"bytes={begin}-{size - 1}"}, status=206):
                    out.write(piece)
                    progress(out.tell())
        draft.touch()
        draft.rename(file)


def _upload(view: RecordingView) -> Upload:
    name = f"{view.machine}/{view.recording}"
    return Upload(name, view.name, view.length, view.size, 0.0, view.fingerprint)

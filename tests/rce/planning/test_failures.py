"""Why there is no path."""

from __future__ import annotations

from rce.errors import RceError
from rce.planning.failures import NoPath, Reason, timed_out


def test_reason_crosses_to_other_processes() -> None:
    sent = timed_out(2.0).info
    received = RceError.from_info(sent)
    assert (sent.code, received.info.fields["reason"]) == ("no_path", "timeout")
    assert "2 s" in str(received)
    assert isinstance(received, NoPath)
    assert received.reason is Reason.TIMEOUT

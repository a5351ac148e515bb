"""Validation of requests for jobs of the map service."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rce.api.map_jobs import FINAL_STATES, MAPPERS, MAX_FILES, Job, JobRequest, MapOptions, State


def test_job_with_defaults_needs_uploads_only() -> None:
    job = msgspec.convert({"uploads": ["0a"]}, JobRequest)
    assert (job.options, job.name) == (MapOptions("graph", 0.05, 30.0, "", ""), "")
    assert job.options.mapper in MAPPERS


@pytest.mark.parametrize(
    "request_body",
    [
        {},
        {"uploads": []},
        {"uploads": ["0a"] * (MAX_FILES + 1)},
        {"uploads": ["../etc/passwd"]},
        {"uploads": [""]},
        {"uploads": ["0A"]},
        {"uploads": ["0a\n"]},
        {"uploads": ["0a"], "name": "x" * 201},
        {"uploads": ["0a"], "colour": "red"},
    ],
)
def test_malformed_request_is_refused(request_body: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(request_body, JobRequest)


@pytest.mark.parametrize(
    "options",
    [
        {"mapper": "magic"},
        {"resolution": 0.001},
        {"resolution": 0.6},
        {"resolution": float("nan")},
        {"max_range": 0.5},
        {"max_range": 201},
        {"scan_topic": "scan"},
        {"scan_topic": "/scan;rm"},
        {"scan_topic": "/scan\n"},
        {"odometry_topic": "/" + "x" * 255},
        {"speed": 1},
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(options, MapOptions)


def test_options_at_their_limits_are_accepted() -> None:
    for options in (
        {"resolution": 0.01, "max_range": 1},
        {"resolution": 0.5, "max_range": 200, "scan_topic": "/a/b_2"},
    ):
        msgspec.convert(options, MapOptions)


def test_job_that_can_still_change_is_not_final() -> None:
    states = set(msgspec.json.schema(State)["enum"])
    assert states - FINAL_STATES == {"queued", "running", "cancelling"}
    assert states > FINAL_STATES


def test_new_job_has_no_progress() -> None:
    job = Job("1", "queued", "drive.bag", MapOptions(), ["0a"], 5.0)
    assert (job.started, job.ended, job.total, job.scans, job.files, job.error) == (None, None, None, 0, [], None)

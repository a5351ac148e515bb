"""REST, tus and SOAP of the map service, and the Master's API: requests of users, mutated and by their documents."""

from __future__ import annotations

import asyncio
import base64
import os
import sys
from pathlib import Path

import pytest

from tests.support.fuzz.mutation import Mutator
from tests.support.fuzz.requests import Parts, ask, mutated
from tests.support.fuzz.target import Target, port_of
from tests.support.paths import TESTS
from tests.support.soap import envelope

pytestmark = pytest.mark.slow

AT_ONCE = 10
SEEDS = 5  # of schemathesis in a run of a million cases
UPLOAD = "a" * 32
LOG = b"FLASER 3 1.0 1.0 1.0 0 0 0 0 0 0 1.0 host 1.0\n" * 5
TUS = {"Tus-Resumable": "1.0.0"}
NAME = base64.b64encode(b"a.log").decode()
METADATA = f"filename {NAME},fingerprint {NAME}"
JOB = {"uploads": [UPLOAD], "name": "n", "options": {"mapper": "graph", "resolution": 0.05, "max_range": 30.0}}
RECORDING = f"<r:recording><r:name>a.log</r:name><r:content>{base64.b64encode(LOG).decode()}</r:content></r:recording>"
XML = {"Content-Type": "text/xml; charset=utf-8", "SOAPAction": '""'}
OPERATIONS = (
    f"<r:SubmitMap>{RECORDING}<r:options><r:max_range>20</r:max_range></r:options></r:SubmitMap>",
    f"<r:SubmitMap><r:upload>{UPLOAD}</r:upload></r:SubmitMap>",
    f"<r:GetStatus><r:job>{UPLOAD}</r:job></r:GetStatus>",
    f"<r:GetResult><r:job>{UPLOAD}</r:job><r:file>map.png</r:file></r:GetResult>",
    f"<r:CancelMap><r:job>{UPLOAD}</r:job></r:CancelMap>",
)
REQUESTS: tuple[Parts, ...] = (
    (
        "POST",
        "/uploads",
        {**TUS, "Upload-Length": "240", "Upload-Metadata": f"filename {NAME},fingerprint {NAME}"},
        b"",
    ),
    ("POST", "/uploads", {**TUS, "Upload-Length": "9", "Content-Type": "application/offset+octet-stream"}, LOG[:9]),
    ("PATCH", f"/uploads/{UPLOAD}", {**TUS, "Upload-Offset": "0"}, LOG),
    ("HEAD", f"/uploads/{UPLOAD}", TUS, b""),
    ("DELETE", f"/uploads/{UPLOAD}", TUS, b""),
    ("POST", "/jobs", {"Content-Type": "application/json"}, JOB),
    ("GET", "/jobs?limit=5", {}, b""),
    ("GET", f"/jobs/{UPLOAD}/files/map.png", {"Range": "bytes=0-10"}, b""),
    *(("POST", "/soap", XML, envelope(each).encode()) for each in OPERATIONS),
)


@pytest.mark.share(0.05)
async def test_each_request_of_a_user_is_answered(target: Target, cases: int, seed: str) -> None:
    mutator = Mutator(f"{seed} maps")
    port = port_of(target.maps)
    for start in range(0, cases, AT_ONCE):
        requests = [
            mutated(mutator, "/map-service", REQUESTS, _starts_a_process) for _ in range(min(AT_ONCE, cases - start))
        ]
        answers = await asyncio.gather(*(ask(port, each) for each in requests))
        for request, answer in zip(requests, answers, strict=True):
            status = answer[9:12]
            assert status.isdigit(), (request, answer)
            assert status < b"500" or b"soap:" in answer, (request, answer)  # SOAP 1.1 has 500 for each fault
            assert b"internal error" not in answer, (request, answer)
    await target.check("requests of a user at the map service")


def _starts_a_process(body: bytes) -> bool:
    """Return True for bodies of which each good one would start a process that looks at it."""
    return b"SubmitMap" in body


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Leave the Master out of a usual run: tests/master/api runs one seed of it, which takes a minute."""
    if "service" in metafunc.fixturenames:
        many = metafunc.config.getoption("--cases", 0) * SEEDS >= 1_000_000
        metafunc.parametrize("service", ["master", "maps"] if many else ["maps"])


@pytest.mark.share(SEEDS / 1_000_000)
@pytest.mark.timeout(3600)
async def test_requests_by_the_document_are_answered_as_it_says(
    target: Target, cases: int, seed: str, tmp_path: Path, service: str
) -> None:
    """Schemathesis, with as many seeds as there are cases; it makes up to some thousand requests of each."""
    maps = f"{target.maps}/map-service/openapi.json"
    document = {"master": f"{target.processes.url}api/v1/openapi.json", "maps": maps}[service]
    key = await target.create_key()
    paths = {"master": ("/api/v1/events", "/api/v1/live"), "maps": ("/map-service/jobs/{job}/events",)}[service]
    left_out = [word for path in paths for word in ("--exclude-path", path)]
    # Wrong passwords make it wait (429), there is no machine for environments (503), unknown headers are accepted, the
    # document cannot tell what the metadata of tus must be, and it keeps its own key.
    left_out += ["--exclude-checks", "ignored_auth,not_a_server_error,positive_data_acceptance,negative_data_rejection"]
    left_out += ["--exclude-operation-id-regex", "keys_key|post_api_v_keys|users"] * (service == "master")
    for number in range(max(1, cases)):
        words = [
            *(str(Path(sys.executable).with_name("st")), "run", document, "--header", f"Authorization: Bearer {key}"),
            *("--seed", str(1000 * int(seed) + number), "--max-examples", "1", "--no-color"),
            *("--generation-database", "none", "--request-timeout", "60", "--continue-on-failure"),
            *("--phases", "coverage,fuzzing", *left_out),
        ]
        hooks = {"SCHEMATHESIS_HOOKS": "schemathesis_hooks", "PYTHONPATH": str(TESTS / "support" / "master")}
        process = await asyncio.create_subprocess_exec(
            *words,
            cwd=tmp_path,
            env=os.environ | hooks,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        output, _ = await process.communicate()
        assert process.returncode == 0, output.decode()
    await target.check(f"schemathesis, {service}")

"""The C++ client at a real platform, and its package for CMake.

The tests build it once, without optimization. RCE_TEST_CXX names another compiler than g++, and RCE_TEST_SANITIZERS its
sanitizers, such as `address,undefined` or `thread`; with them the build takes some ten minutes.
"""

from __future__ import annotations

import asyncio
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from rce.api.client import ApiClient
from rce.api.views import NewOffer, OfferedNode, OfferView
from rce.net.certificates import Authority
from rce.net.tls import CA, CERTIFICATE, KEY
from tests.support.certificates import certify
from tests.support.client_cases import CPP, expected
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.paths import TESTS
from tests.support.programs import run_program

pytestmark = pytest.mark.timeout(900)  # the first test compiles, which takes more than five minutes on a slow machine

STRING = "std_msgs/String"
TIMEOUT = 240  # seconds; a limit that only ends what hangs
HEADERS = ("boost/beast.hpp", "openssl/ssl.h", "nlohmann/json.hpp", "simdjson.h")
COMPILER, SANITIZERS = os.environ.get("RCE_TEST_CXX", "g++"), os.environ.get("RCE_TEST_SANITIZERS", "")


def check_programs() -> None:
    """Skip the tests where what they need to compile is absent."""
    missing = [program for program in ("cmake", "make", COMPILER) if shutil.which(program) is None]
    missing += [header for header in HEADERS if not (Path("/usr/include") / header).exists()]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)}; `provisioning/provision test` as root installs them")


def run(*words: object) -> str:
    """Run a program; return its output."""
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def build(source: Path, directory: Path, *options: str) -> None:
    """Configure and build a CMake project."""
    flags = "-O0 -g0" + (f" -g1 -fno-omit-frame-pointer -fsanitize={SANITIZERS}" if SANITIZERS else "")
    if SANITIZERS == "thread" and COMPILER.endswith("g++"):
        flags += " -Wno-tsan"  # Boost.Asio uses a fence, which this sanitizer does not know
    words = (f"-DCMAKE_CXX_COMPILER={COMPILER}", f"-DCMAKE_CXX_FLAGS={flags}", "-DCMAKE_BUILD_TYPE=None")
    run("cmake", "-S", source, "-B", directory, *words, *options)
    run("cmake", "--build", directory, "--parallel", "2")


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of the test programs, built with the library and its example and with warnings as errors."""
    check_programs()
    directory = tmp_path_factory.mktemp("cpp")
    prefix = f"-DCMAKE_INSTALL_PREFIX={directory / 'prefix'}"
    build(TESTS / "cpp", directory / "build", prefix, "-DRCE_STRICT=ON", "-DRCE_BUILD_EXAMPLES=ON")
    return directory / "build"


async def run_beside(*words: object, **environ: str) -> tuple[int, str, str]:
    """Run a program beside the platform; return its status, its output and its errors."""
    options = {
        "UBSAN_OPTIONS": "halt_on_error=1",
        "TSAN_OPTIONS": f"halt_on_error=1 suppressions={TESTS / 'cpp' / 'tsan.supp'}",
    }
    return await run_program(*map(str, words), seconds=TIMEOUT, env={**os.environ, **options, **environ})


async def output_of(*words: object, **environ: str) -> str:
    """Run a program beside the platform; return its output."""
    status, out, err = await run_beside(*words, **environ)
    assert status == 0, err[-6000:]
    return out


async def test_client_contract(programs: Path, platform: RealPlatform) -> None:
    out = await output_of(programs / "contract", platform.url, "cpp")
    assert set(out.splitlines()) == expected(CPP)


async def test_json_is_read_and_written_as_nlohmann_does(programs: Path) -> None:
    assert "values are equal" in await output_of(programs / "json")


@pytest.mark.skipif(bool(SANITIZERS), reason="sanitizers have their own malloc")
async def test_large_blocks_are_kept(programs: Path) -> None:
    faults, _, rest = (await output_of(programs / "memory")).partition(" ")
    assert rest == "page faults\n"
    assert int(faults) < 2000  # 100,000 without the setting


async def test_robot_reconnects_many_times(programs: Path, platform: RealPlatform) -> None:
    assert "50 reconnections" in await output_of(programs / "reconnect", platform.url, "cppr", "50")


async def test_robot_uses_tls(programs: Path, arguments: list[str], tmp_path: Path) -> None:
    """With a file of certificates or those of the system; a certificate that nobody has signed is refused."""
    keys = certify(tmp_path / "keys", Authority.make("platform"), ["127.0.0.1"])
    options = "--certificate", str(keys / CERTIFICATE), "--private-key", str(keys / KEY)
    cases = ["raw bytes of any size arrive unchanged", "resumed session keeps interfaces and connections"]
    (tmp_path / "platform").mkdir()
    async with RealPlatform(tmp_path / "platform", *arguments, *options) as platform:
        assert platform.url.startswith("https://127.0.0.1:")
        out = await output_of(programs / "contract", platform.url, "tls", *cases, RCE_TEST_CA=str(keys / CA))
        assert out.splitlines() == cases
        robot = programs / "rce" / "examples" / "rce_robot", platform.url, USER, USER
        assert await output_of(*robot, SSL_CERT_FILE=str(keys / CA)) == "the node answered: hello\n"
        status, _, err = await run_beside(*robot)
        assert (status, "certificate verify failed" in err) == (1, True), err


async def test_service_of_the_catalogue_is_used(programs: Path, platform: RealPlatform) -> None:
    echo = OfferedNode("echo", "rce_demo", "echo", perRobot=True, args="--ros-args -r /say:=say -r /heard:=heard")
    offer = NewOffer(
        name="parrot_cpp", takes={"say": STRING}, gives={"heard": STRING}, nodes=[echo], robots=5, idle=1.0
    )
    client = ApiClient(platform.url, user=USER, password=USER)
    await asyncio.to_thread(client.post, OfferView, "catalogue", body=offer)
    name = f"{USER}/parrot_cpp"
    assert await output_of(programs / "catalogue", platform.url, "cppc", name) == f"{name} cpp shared\n"
    await asyncio.to_thread(client.delete, "catalogue", USER, "parrot_cpp")


async def test_example_runs(programs: Path, platform: RealPlatform) -> None:
    out = await output_of(programs / "rce" / "examples" / "rce_robot", platform.url, USER, USER)
    assert out == "the node answered: hello\n"


async def test_installed_package_is_found(programs: Path, tmp_path: Path) -> None:
    run("cmake", "--install", programs)
    build(TESTS / "cpp" / "consumer", tmp_path, f"-DCMAKE_PREFIX_PATH={programs.with_name('prefix')}")
    assert await output_of(tmp_path / "consumer") == "unavailable\n"

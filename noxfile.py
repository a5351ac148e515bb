"""Sessions for development, each in the environment that `provisioning/provision test` makes (.venv).

Only `docs` has an environment of its own. Start `nox --list` for all of them.
"""

from __future__ import annotations

import nox

from provisioning.development import IN_TWO_PROCESSES, KUBERNETES, PYTHON, QUICK, REST

nox.options.sessions = ["lint", "types", "unit"]
nox.options.default_venv_backend = "none"

SCRIPT = "provisioning/provision"
MODULE = (str(PYTHON), "-m")


@nox.session
def lint(session: nox.Session) -> None:
    """Check style and formatting by ruff."""
    session.run(*MODULE, "ruff", "check", ".", SCRIPT)
    session.run(*MODULE, "ruff", "format", "--check", ".", SCRIPT)


@nox.session
def types(session: nox.Session) -> None:
    """Check types by mypy."""
    session.run(*MODULE, "mypy")
    session.run(*MODULE, "mypy", "--scripts-are-modules", SCRIPT)


@nox.session
def unit(session: nox.Session) -> None:
    """Run the quick tests, the first stage of CI. Arguments after -- go to pytest."""
    session.run(*MODULE, "pytest", *IN_TWO_PROCESSES, *QUICK, *session.posargs)


@nox.session
def coverage(session: nox.Session) -> None:
    """Run the quick tests and write a report of their branch coverage to build/coverage."""
    session.run(*MODULE, "pytest", *IN_TWO_PROCESSES, *QUICK, "--cov", "--cov-report=", *session.posargs)
    session.run(*MODULE, "coverage", "html", "--quiet", "--directory", "build/coverage")


@nox.session
def integration(session: nox.Session) -> None:
    """Run the tests that need ROS 2 or Docker, but no whole platform."""
    session.run(*MODULE, "pytest", *IN_TWO_PROCESSES, "-m", "(ros or docker or slow) and not e2e", *session.posargs)


@nox.session
def e2e(session: nox.Session) -> None:
    """Run the tests of whole platforms."""
    session.run(*MODULE, "pytest", *IN_TWO_PROCESSES, "-m", "e2e", *session.posargs)


@nox.session
def rest(session: nox.Session) -> None:
    """Run what `unit` leaves out, the second stage of CI."""
    session.run(*MODULE, "pytest", *IN_TWO_PROCESSES, *REST, *session.posargs)


@nox.session
def kubernetes(session: nox.Session) -> None:
    """Build a Kubernetes cluster, unless it is cached, and run the tests of the engine `kubernetes` on it, as root."""
    session.run(*MODULE, "tests.support.kubernetes.build")
    session.run(*MODULE, "pytest", *KUBERNETES, *session.posargs)


@nox.session(venv_backend="virtualenv")
def docs(session: nox.Session) -> None:
    """Build the documentation site into build/site."""
    session.install("-c", "provisioning/constraints.txt", "-e", ".[docs]", "ruff")  # ruff wraps signatures
    quiet = {"NO_MKDOCS_2_WARNING": "1"}  # an advertisement of MkDocs Material for its successor
    session.run("mkdocs", "build", "--strict", *session.posargs, env=quiet)


@nox.session(venv_backend="virtualenv")
def lock(session: nox.Session) -> None:
    """Update provisioning/constraints.txt to the newest versions that pyproject.toml allows. Then run all tests."""
    session.install("uv")
    session.run(
        "uv", "pip", "compile", "--quiet", "--upgrade", "--universal", "--all-extras", "--strip-extras",
        "--no-emit-index-url", "--python-version", "3.11", "--custom-compile-command", "nox -s lock",
        "--output-file", "provisioning/constraints.txt", "pyproject.toml",
    )  # fmt: skip

"""Builder of the servers of Kubernetes from Debian's source package: `python -P -m tests.support.kubernetes.build`.

No package has them. The result is in the user's cache directory, by version; a build takes about ten minutes on one
core and 2 GB of disk, most of which is removed at its end.
"""

from __future__ import annotations

import glob
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

VERSION = "1.20.2"
PROGRAMS = ("kube-apiserver", "kube-controller-manager", "kube-scheduler", "kubelet", "kube-proxy")
COMMAND = "nox -s kubernetes"
TO_RUN = {"etcd-server": "etcd", "kubernetes-client": "kubectl", "openssl": "openssl"}  # packages and their programs
DEBIAN = {"golang-go": "go", "dpkg-dev": "dpkg-source", **TO_RUN}
SOURCE = "kubernetes"
VENDOR = "k8s.io/kubernetes/vendor/k8s.io"
VERSIONS = (f"{VENDOR}/component-base/version", f"{VENDOR}/client-go/pkg/version")  # else these say v0.0.0
SUITE = "bookworm"
GENERATED = "+k8s:openapi-gen="  # marks the packages for which code is generated before the build
WITHOUT = ("code-generator", "sample-apiserver", "_test.go", "zz_generated", "/cmd/openapi-gen", "/testdata/")
SOURCES = """Types: deb-src
URIs: {mirror}
Suites: {suite}
Components: main
Signed-By: /usr/share/keyrings/debian-archive-keyring.gpg
"""


def directory() -> Path:
    """Return the directory of the programs, which may not exist."""
    cache = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(cache) / "rce" / "kubernetes" / VERSION


def lacking() -> str:
    """Return why no cluster can be run here, and the command that helps; empty if one can."""
    if os.geteuid() != 0:
        return "nodes of a cluster need root: run the tests as root"
    if not all((directory() / name).exists() for name in PROGRAMS):
        return f"Kubernetes {VERSION} is not built: `{COMMAND}` builds it in about ten minutes and runs all its tests"
    needed = (*TO_RUN.values(), "dockerd", "ip")
    missing = [name for name in needed if shutil.which(name, path=_path()) is None]
    return f"no {', '.join(missing)}: `{COMMAND}` installs them" if missing else ""


def build() -> Path:
    """Build the programs unless that was done before; return their directory. Needs root and apt."""
    target = directory()
    if not lacking():
        return target
    _install()
    if all((target / name).exists() for name in PROGRAMS):
        return target
    work = target.with_name(f"build-{VERSION}")
    tree = work / "go" / "src" / "k8s.io" / "kubernetes"
    tree.mkdir(parents=True, exist_ok=True)
    _fetch(work, tree)
    environment = {
        **os.environ,
        "GOPATH": str(work / "go"),
        "GOCACHE": str(work / "cache"),
        "GO111MODULE": "off",
        "GOFLAGS": "",
        "GOPROXY": "off",
        "CGO_ENABLED": "0",
    }
    _generate(work, tree, environment)
    version = " ".join(f"-X {package}.gitVersion=v{VERSION}" for package in VERSIONS)
    for name in PROGRAMS:
        print(f"building {name}", flush=True)
        words = ["go", "build", "-ldflags", f"-s -w {version}", "-o", str(work / "bin" / name), f"./cmd/{name}"]
        subprocess.run(words, cwd=tree, env=environment, check=True)
    target.mkdir(exist_ok=True)
    for name in PROGRAMS:
        shutil.move(work / "bin" / name, target / name)
    subprocess.run(["chmod", "-R", "u+w", str(work)], check=True)
    shutil.rmtree(work)
    return target


def _path() -> str:
    return os.environ.get("PATH", os.defpath) + ":/usr/sbin:/sbin"


def _install() -> None:
    missing = [package for package, program in DEBIAN.items() if shutil.which(program, path=_path()) is None]
    if not missing:
        return
    quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    options = ["-o", "Acquire::Retries=3", "-o", "DPkg::Lock::Timeout=600"]
    subprocess.run(["apt-get", *options, "update"], check=True, env=quiet)
    words = ["apt-get", *options, "install", "-y", "--no-install-recommends", *missing]
    subprocess.run(words, check=True, env=quiet)


def _mirror() -> str:
    """Return the archive from which this machine gets Debian's packages."""
    words = ["apt-get", "indextargets", "--format", "$(REPO_URI) $(SUITE) $(COMPONENT)", "Created-By: Packages"]
    lines = subprocess.run(words, check=True, capture_output=True, text=True).stdout.splitlines()
    found = [uri for uri, suite, component in map(str.split, lines) if component == "main" and "-" not in suite]
    if not found:
        raise SystemExit("apt has no archive of Debian's packages: run apt-get update")
    return found[0]


def _fetch(work: Path, tree: Path) -> None:
    """Download and unpack the source, with lists of apt's own that leave those of the system alone."""
    lists, sources = work / "lists", work / "debian.sources"
    lists.mkdir(exist_ok=True)
    sources.write_text(SOURCES.format(mirror=_mirror(), suite=SUITE))
    options = ["-o", f"Dir::Etc::sourcelist={sources}", "-o", "Dir::Etc::sourceparts=/dev/null"]
    options += ["-o", f"Dir::State::lists={lists}", "-o", "Acquire::Retries=3", "-o", "APT::Sandbox::User=root"]
    subprocess.run(["apt-get", *options, "update"], check=True)
    subprocess.run(["apt-get", *options, "source", "--download-only", SOURCE], cwd=work, check=True)
    (archive,) = glob.glob(str(work / f"{SOURCE}_*.orig.tar.*"))
    subprocess.run(["tar", "-xf", archive, "-C", str(tree), "--strip-components=1"], check=True)


def _generate(work: Path, tree: Path, environment: Mapping[str, str]) -> None:
    """Generate the file of the API server that the source package lacks."""
    generator = work / "bin" / "openapi-gen"
    package = "./vendor/k8s.io/kube-openapi/cmd/openapi-gen"
    subprocess.run(["go", "build", "-o", str(generator), package], cwd=tree, env=environment, check=True)
    words = [str(generator), "-i", ",".join(_marked(tree)), "-p", "k8s.io/kubernetes/pkg/generated/openapi"]
    words += ["-O", "zz_generated.openapi", "-h", "hack/boilerplate/boilerplate.generatego.txt"]
    words += ["-r", str(work / "violations"), "--output-base", str(work / "go" / "src")]
    subprocess.run(words, cwd=tree, env=environment, check=True)


def _marked(tree: Path) -> list[str]:
    """Return the packages for which code is generated."""
    found = set()
    for top in ("pkg", "cmd", "staging/src", "vendor/k8s.io"):
        words = ["grep", "-rl", "--include=*.go", GENERATED, top]
        for file in subprocess.run(words, cwd=tree, stdout=subprocess.PIPE, text=True).stdout.splitlines():
            if not any(each in file for each in WITHOUT):
                place = os.path.dirname(file).removeprefix("staging/src/").removeprefix("vendor/")
                staged = file.startswith(("staging/", "vendor/"))
                found.add(f"k8s.io/kubernetes/vendor/{place}" if staged else f"k8s.io/kubernetes/{place}")
    return sorted(found)


if __name__ == "__main__":
    print(build())
    sys.exit(0)

"""Clocks that jump: a library that shifts the time of day of one process by the seconds that a file has.

Monotonic clocks do not jump, as on a machine whose time of day is set.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

VARIABLE = "RCE_CLOCK"
SOURCE = r"""
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static long shift(void) {
  static volatile const double *seconds;
  if (!seconds) {
    const char *name = getenv("RCE_CLOCK");
    int file = name ? open(name, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0) return 0;
    void *place = mmap(0, sizeof(double), PROT_READ, MAP_SHARED, file, 0);
    close(file);
    if (place == MAP_FAILED) return 0;
    seconds = place;
  }
  return (long)*seconds;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
  int failed = syscall(SYS_clock_gettime, clock, now);
  if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) now->tv_sec += shift();
  return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
  struct timespec found;
  (void)zone;
  if (clock_gettime(CLOCK_REALTIME, &found)) return -1;
  now->tv_sec = found.tv_sec;
  now->tv_usec = found.tv_nsec / 1000;
  return 0;
}

time_t time(time_t *place) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (place) *place = now.tv_sec;
  return now.tv_sec;
}
"""


def build(directory: Path) -> Path | None:
    """Compile the library; return None if there is no C compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    source, library = directory / "clock.c", directory / "clock.so"
    source.write_text(SOURCE)
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", library, source], check=True, capture_output=True)
    return library


class Clock:
    """The time of day of one process."""

    def __init__(self, library: Path | None, file: Path) -> None:
        """Use a library that `build` made; without one the clock cannot jump."""
        self._library = library
        self._file = file
        if library is not None:
            file.write_bytes(struct.pack("d", 0.0))
            file.chmod(0o644)  # PostgreSQL runs as another user

    @property
    def can_jump(self) -> bool:
        """True if `set` has an effect."""
        return self._library is not None

    @property
    def environment(self) -> dict[str, str]:
        """Variables for the process."""
        return {"LD_PRELOAD": str(self._library), VARIABLE: str(self._file)} if self._library is not None else {}

    def set(self, seconds: float) -> None:
        """Shift the clock by some seconds from the true time."""
        with self._file.open("r+b") as file:  # not a new file: the process has mapped this one
            file.write(struct.pack("d", seconds))

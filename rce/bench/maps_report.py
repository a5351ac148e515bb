"""Results of `rce bench map` and `rce bench endless` as text and as JSON, with those of other systems."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from rce.bench.maps import Mapped, Results
from rce.bench.report import aligned, machine
from rce.mapping.evaluation.trials import Endless, flatness

MEGA, MILLI = 1e6, 1e3
KINDS = {"benchmark": "benchmark", "near": "2 m apart", "far": "20 m and more", "loop": "revisited"}


class Baseline(NamedTuple):
    """Mean errors of another system on the same relations.

    Attributes:
        system: Name of the system.
        translation: Metres.
        rotation: Degrees.
        cpu: CPU seconds; None if not measured.
    """

    system: str
    translation: float
    rotation: float
    cpu: float | None


BASELINES: dict[str, tuple[Baseline, ...]] = {  # measured on a machine with 2 shared cores unless marked as published
    "mit-csail": (
        Baseline("odometry alone", 1.68, 5.07, None),
        Baseline("GMapping, 30 particles, every 1 m", 0.0432, 2.06, 47.5),
        Baseline("GMapping, 30 particles, every 0.5 m", 0.0554, 1.87, 86.7),
        Baseline("Karto, every 0.2 m", 0.0350, 0.67, 20.1),
        Baseline("Cartographer, published (Hess et al. 2016)", 0.0319, 0.369, None),
    ),
}


def baselines(recording: str) -> tuple[Baseline, ...]:
    """Return the results of other systems on a recording."""
    return BASELINES.get(recording.partition(".")[0], ())


def as_data(results: Results) -> dict[str, Any]:
    """Return the results for JSON."""
    data: dict[str, Any] = msgspec.to_builtins({"machine": machine(), **msgspec.structs.asdict(results)}, enc_hook=str)
    return data


def as_text(results: Results) -> str:
    """Return tables of the map service (RoboWS, table 2 with the times of figure 3b) and of each mapper alone."""
    host = machine()
    title = f"Maps of recordings; {host['processor']}, {host['cores']} cores, load {host['load']:.1f}"
    lines = [title, "", *aligned(_service_table(results))]
    lines += ["", "mappers alone; mean errors in metres, degrees", *aligned(_mapper_table(results.mapped))]
    for recording in results.recordings:
        known = baselines(recording.name)
        if known and recording.relations:
            lines += ["", f"{recording.name}, other systems", *aligned(_baseline_table(known))]
    return "\n".join(lines)


def _service_table(results: Results) -> list[list[str]]:
    mappers = list(dict.fromkeys(each.mapper for each in results.served))
    times = {(each.recording, each.mapper): each for each in results.served}
    head = ["recording", "MB", "scans", "messages", "way m"]
    if mappers:
        head += ["transmission s", *(f"mapping s, {mapper}" for mapper in mappers)]
    rows = [head]
    for each in results.recordings:
        row = [each.name, f"{each.size / MEGA:.2f}", str(each.scans), str(each.messages), f"{each.way:.0f}"]
        served = [times.get((each.name, mapper)) for mapper in mappers]
        if mappers:
            row.append(f"{min(one.transmission for one in served if one):.2f}")
        rows.append([*row, *(f"{one.mapping:.1f}" if one else "" for one in served)])
    return rows


def _mapper_table(mapped: Sequence[Mapped]) -> list[list[str]]:
    kinds = [kind for kind in KINDS if any(kind in each.errors for each in mapped)]
    rows = [["recording", "mapper", "odometry", "CPU s", "MB", *(KINDS[kind] for kind in kinds), "loops"]]
    for each in mapped:
        errors = [each.errors.get(kind) for kind in kinds]
        cells = [f"{error[0]:.3f} {error[1]:.2f}°" if error else "" for error in errors]
        loops = {None: "", True: "closed", False: "OPEN"}[each.closed]
        memory = f"{each.memory / MEGA:.0f}"
        rows.append([each.recording, each.mapper, each.odometry, f"{each.cpu:.1f}", memory, *cells, loops])
    return rows


def _baseline_table(known: Sequence[Baseline]) -> list[list[str]]:
    rows = [["system", "CPU s", "m", "degrees"]]
    for each in known:
        cpu = "" if each.cpu is None else f"{each.cpu:.1f}"
        rows.append([each.system, cpu, f"{each.translation:.3f}", f"{each.rotation:.2f}"])
    return rows


def endless_text(runs: Mapping[str, Endless]) -> str:
    """Return a table of the memory at the start, after a quarter and at the end, and of times a scan."""
    rows = [
        ["", "scans", "MB at first", "after a quarter", "at last", "ms CPU a scan", "last quarter / second", "longest"]
    ]
    for name, each in runs.items():
        memory = [each.memory[place] / MEGA for place in (0, len(each.memory) // 4, -1)]
        mean, longest = each.seconds.mean() * MILLI, each.longest.max() * MILLI
        flat = f"{flatness(each.seconds):.2f}"
        row = [
            name,
            str(each.scans[-1]),
            *(f"{value:.0f}" for value in memory),
            f"{mean:.2f}",
            flat,
            f"{longest:.0f} ms",
        ]
        rows.append(row)
    return "\n".join(aligned(rows))


def endless_data(runs: Mapping[str, Endless]) -> dict[str, Any]:
    """Return the measurements of endless runs for JSON."""
    columns = ("scans", "seconds", "longest", "memory")
    return {
        "machine": machine(),
        "runs": {name: {column: getattr(each, column).tolist() for column in columns} for name, each in runs.items()},
    }

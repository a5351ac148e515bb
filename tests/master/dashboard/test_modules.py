"""Modules of the dashboard that need no browser, in Node."""

from __future__ import annotations

import io
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master.dashboard import FOLDERS
from rce.mapping3d.dense.mesh import Cloud
from rce.mapping3d.dense.ply import cloud_ply
from rce.packages import archive
from rce.packages.archive import Entry
from rce.protocol import terminal
from tests.support.e2e.node import node_command

LONG = f"pkg/{'a' * 60}/{'b' * 70}"
FILES = {"pkg/package.xml": b"<package/>", LONG: b"x" * 700, "pkg/empty": b"", "pkg/run": b"#!/bin/sh"}


def run(module: str, script: str) -> Any:
    """Return what a script prints as JSON; it may use the names that the module exports."""
    path = (FOLDERS[""] / module).as_uri()
    text = f"const m = await import({json.dumps(path)}); const done = await (async () => {{ {script} }})();"
    words = [*node_command(), "--input-type=module", "-e", f"{text} console.log(JSON.stringify(done));"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_archive_is_the_one_that_the_console_makes(tmp_path: Path) -> None:
    entries = []
    for number, (name, content) in enumerate(FILES.items()):
        source = tmp_path / str(number)
        source.write_bytes(content)
        entries.append(Entry(name, source, executable=name.endswith("run")))
    expected = io.BytesIO()
    archive.write(entries, expected)
    files = json.dumps([[name, list(content), name.endswith("run")] for name, content in FILES.items()])
    made = run(
        "tar.js",
        f"return [...m.archive({files}.map(([path, bytes, executable]) => "
        "({ path, bytes: Uint8Array.from(bytes), executable })))]",
    )
    assert bytes(made) == expected.getvalue()


@pytest.mark.parametrize("path", ["a/" + "b" * 101, "umläut"])
def test_path_that_no_archive_can_hold_is_refused(path: str) -> None:
    files = json.dumps([{"path": path, "bytes": []}])
    script = f"try {{ m.archive({files}) }} catch (error) {{ return error.message }}"
    assert path in run("tar.js", script)


def test_events_go_on_after_the_last_one_when_the_stream_breaks() -> None:
    asked = run(
        "events.js",
        """const [asked, signal] = [[], { aborted: false }];
        globalThis.setTimeout = (work) => queueMicrotask(work);
        const follow = async function* (path, query) {
            asked.push(query.after ?? "");
            signal.aborted = asked.length === 2;
            if (signal.aborted) return;
            yield { id: "1f-7", type: "robot.came" };
            throw new TypeError("network error");
        };
        await m.followEvents({ api: { follow } }, signal);
        return asked;""",
    )
    assert asked == ["", "1f-7"]


def test_terminal_frames_are_those_of_the_console() -> None:
    frames = run(
        "terminalstream.js",
        "const sent = []; const s = new m.Sending((f) => sent.push([...f]), () => now); var now = 0;"
        "s.write(Uint8Array.from([1, 2, 3])); now = 5000; s.tick();"
        "const r = new m.Receiving(); const fresh = r.receive(Uint8Array.from(sent[0].slice(1)));"
        "s.acknowledged(r.acknowledgement().subarray(1)); now = 99999; s.tick();"
        "return { sent, fresh: [...fresh], ack: [...r.acknowledgement()], size: [...m.frames.size(24, 80)],"
        " cdr: [...m.toCdr(Uint8Array.from([7, 8]))], back: [...m.fromCdr(m.toCdr(Uint8Array.from([7, 8])))] }",
    )
    expected: list[bytes] = []
    terminal.SendStream(expected.append).write(bytes([1, 2, 3]))
    assert [bytes(each) for each in frames["sent"]] == expected * 2, (
        "sent again once, and not after its acknowledgement"
    )
    assert frames["fresh"] == [1, 2, 3]
    received = terminal.ReceiveStream()
    received.receive(expected[0][1:])
    assert bytes(frames["ack"]) == received.acknowledgement()
    assert bytes(frames["size"]) == terminal.size_frame(24, 80)
    assert bytes(frames["cdr"]) == terminal.to_cdr(bytes([7, 8]))
    assert frames["back"] == [7, 8]


def test_transforms_lead_to_the_root_of_the_tree() -> None:
    """The laser is 1 m ahead of a robot that stands at (2, 0) and looks along y."""
    found = run(
        "tf.js",
        "const t = new m.Transforms(); const h = Math.SQRT1_2;"
        "t.put({ parent: 'map', child: 'base', translation: [2, 0, 0], rotation: [0, 0, h, h] });"
        "t.put({ parent: '/base', child: 'laser', translation: [1, 0, 0], rotation: [0, 0, 0, 1] });"
        "const { root, matrix } = t.toRoot('laser'); return [root, ...matrix.subarray(12, 15)]",
    )
    assert found == ["map", pytest.approx(2, abs=1e-6), pytest.approx(1, abs=1e-6), 0]


def test_cycle_of_transforms_ends() -> None:
    put = "t.put({{ parent: '{}', child: '{}', translation: [0, 0, 0], rotation: [0, 0, 0, 1] }});"
    script = f"const t = new m.Transforms(); {put.format('a', 'b')} {put.format('b', 'a')} return t.toRoot('a').root"
    assert run("tf.js", script) in ("a", "b")


def test_labels_of_wires_do_not_overlap() -> None:
    shown, overlapping = run(
        "layout.js",
        """const wires = Array.from({ length: 300 }, (_, index) => ({
            key: String(index), texts: [`${index}/s and more`, `${index}/s`],
            at: (t) => [300 + 200 * t, 7 * (index % 40) + 90 * t] }));
        const found = [...m.labels(wires, 200, 700)].map(([key, at]) => ({ ...at, width: 7 * at.text.length }));
        const apart = (a, b) => Math.abs(a.y - b.y) >= 14 || Math.abs(a.x - b.x) >= (a.width + b.width) / 2;
        return [found.length, found.filter((a, index) => found.slice(index + 1).some((b) => !apart(a, b))).length];""",
    )
    assert shown > 20
    assert overlapping == 0


@pytest.mark.parametrize(("width", "text"), [(200, "20/s · 19 KiB/s"), (60, "20/s"), (20, None)])
def test_label_is_as_long_as_there_is_room(width: int, text: str | None) -> None:
    wire = "{ key: 'wire', texts: ['20/s · 19 KiB/s', '20/s'], at: (t) => [t, 0] }"
    assert run("layout.js", f"return m.labels([{wire}], 0, {width}).get('wire')?.text ?? null") == text


def test_codec_of_a_key_frame_is_that_of_its_sequence_parameters() -> None:
    found = run("video.js", "return m.codecName(Uint8Array.from([0, 0, 0, 1, 9, 0, 0, 0, 1, 0x67, 0x64, 0, 0x1e, 5]))")
    assert found == "avc1.64001e"
    script = "try { m.codecName(Uint8Array.from([0, 0, 1, 0x65, 1, 2, 3, 4])) } catch (error) { return error.message }"
    assert "no sequence parameters" in run("video.js", script)


def test_packets_after_a_gap_are_not_decoded_until_a_key_frame_comes() -> None:
    packets = [(0, True), (1, False), (3, False), (4, False), (5, True), (6, False)]
    decoded = run(
        "video.js",
        f"""const decoded = [];
globalThis.EncodedVideoChunk = class {{ constructor(all) {{ Object.assign(this, all); }} }};
globalThis.VideoDecoder = class {{
  state = "unconfigured";
  configure() {{ this.state = "configured"; }}
  decode(chunk) {{ decoded.push([chunk.timestamp / 1000, chunk.type]); }}
}};
const video = new m.Video(() => {{}}, (error) => decoded.push(error.message));
const data = Uint8Array.from([0, 0, 1, 0x67, 0x64, 0, 0x1e, 5]);
for (const [number, key] of {json.dumps(packets)}) video.take({{ number, key, data }});
return decoded;""",
    )
    assert decoded == [[0, "key"], [1, "delta"], [5, "key"], [6, "delta"]]


def test_cloud_of_a_map_is_read_with_its_colours_and_its_level_frame() -> None:
    level = np.arange(16.0).reshape(4, 4)
    cloud = Cloud(
        np.array([[1, 2, 3], [-4, 5.5, 6]], np.float32),
        np.zeros((2, 3), np.float32),
        np.array([[255, 0, 1], [2, 3, 4]], np.uint8),
    )
    content = list(cloud_ply(cloud, level))
    script = (
        f"const {{ points, matrix }} = m.readPly(Uint8Array.from({content}).buffer); return [[...points], [...matrix]]"
    )
    points, matrix = run("ply.js", script)
    assert points == [1, 2, 3, 255 * 65536 + 1, -4, 5.5, 6, 2 * 65536 + 3 * 256 + 4]
    assert matrix == level.T.ravel().tolist()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"no file", "not a binary PLY"),
        (cloud_ply(Cloud(*(np.zeros((1, 3), kind) for kind in ("f4", "f4", "u1"))))[:-1], "not complete"),
    ],
)
def test_damaged_cloud_is_refused_with_the_reason(content: bytes, reason: str) -> None:
    script = f"try {{ m.readPly(Uint8Array.from({list(content)}).buffer) }} catch (error) {{ return error.message }}"
    assert reason in run("ply.js", script)

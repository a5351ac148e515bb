// Video of an interface with the codec h264, decoded by the browser (WebCodecs).

/** Whether this browser decodes video here; pages that were not fetched over TLS or from this machine may not. */
export const canDecode = () => "VideoDecoder" in globalThis;

/** Return the name of the codec of an H.264 key frame (RFC 6381, section 3.3), which its sequence parameters tell. */
export function codecName(bytes) {
  for (let at = 0; at + 6 < bytes.length; at += 1) {
    const start = bytes[at] === 0 && bytes[at + 1] === 0 && bytes[at + 2] === 1;
    if (start && (bytes[at + 3] & 0x1f) === 7) {
      return `avc1.${[...bytes.subarray(at + 4, at + 7)].map((each) => each.toString(16).padStart(2, "0")).join("")}`;
    }
  }
  throw new Error("a key frame of H.264 has no sequence parameters");
}

/** Decodes packets; calls `show` with each image (a VideoFrame), and `failed` with an error after which nothing comes. */
export class Video {
  #decoder = null;
  #expected = -1; // number of the next packet; -1 until a key frame
  #show;
  #failed;

  constructor(show, failed) {
    this.#show = show;
    this.#failed = failed;
  }

  /** Decode a packet: `{number, key, data}`. After a gap nothing is decoded until a key frame comes. */
  take({ number, key, data }) {
    if (!key && number !== this.#expected) {
      this.#expected = -1;
      return;
    }
    this.#expected = number + 1;
    try {
      if (key && this.#decoder?.state !== "configured") this.#open(codecName(data));
      this.#decoder.decode(new EncodedVideoChunk({ type: key ? "key" : "delta", timestamp: number * 1000, data }));
    } catch (error) {
      this.#failed(error);
    }
  }

  close() {
    if (this.#decoder && this.#decoder.state !== "closed") this.#decoder.close();
  }

  #open(codec) {
    this.#decoder = new VideoDecoder({ output: (frame) => this.#show(frame), error: (error) => this.#failed(error) });
    this.#decoder.configure({ codec, optimizeForLatency: true });
  }
}

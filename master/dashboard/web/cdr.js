// Decoders of the ROS messages that come as CDR (little-endian): maps and paths are large, and fast to read this way.

class Reader {
  #view;
  #at = 4; // after the encapsulation header, where alignment begins

  constructor(bytes) {
    this.#view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  #next(size) {
    this.#at += (size - ((this.#at - 4) % size)) % size;
    this.#at += size;
    return this.#at - size;
  }

  uint32() {
    return this.#view.getUint32(this.#next(4), true);
  }

  int32() {
    return this.#view.getInt32(this.#next(4), true);
  }

  float32() {
    return this.#view.getFloat32(this.#next(4), true);
  }

  float64() {
    return this.#view.getFloat64(this.#next(8), true);
  }

  int8s() {
    const length = this.uint32();
    this.#at += length;
    return new Int8Array(this.#view.buffer, this.#view.byteOffset + this.#at - length, length);
  }

  header() {
    [this.int32(), this.uint32()]; // stamp
    this.int8s(); // frame
  }

  /** Read a pose in the plane: metres and radians. */
  pose() {
    const [x, y, , qx, qy, qz, qw] = Array.from({ length: 7 }, () => this.float64());
    return { x, y, angle: Math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)) };
  }
}

/** Decode nav_msgs/OccupancyGrid. */
export function readMap(bytes) {
  const reader = new Reader(bytes);
  reader.header();
  [reader.int32(), reader.uint32()]; // load time
  const [resolution, width, height] = [reader.float32(), reader.uint32(), reader.uint32()];
  return { resolution, width, height, origin: reader.pose(), cells: reader.int8s() };
}

/** Decode map_msgs/OccupancyGridUpdate. */
export function readUpdate(bytes) {
  const reader = new Reader(bytes);
  reader.header();
  const [x, y, width, height] = [reader.int32(), reader.int32(), reader.uint32(), reader.uint32()];
  return { x, y, width, height, cells: reader.int8s() };
}

/** Decode the poses of nav_msgs/Path. */
export function readPath(bytes) {
  const reader = new Reader(bytes);
  reader.header();
  return Array.from({ length: reader.uint32() }, () => {
    reader.header();
    return reader.pose();
  });
}

/** Decode geometry_msgs/PoseStamped or PoseWithCovarianceStamped. */
export function readPose(bytes) {
  const reader = new Reader(bytes);
  reader.header();
  return reader.pose();
}

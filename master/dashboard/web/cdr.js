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

  uint8() {
    return this.#view.getUint8(this.#next(1));
  }

  text() {
    const bytes = this.int8s();
    return new TextDecoder().decode(bytes.subarray(0, -1)); // without the zero at its end
  }

  /** Read a std_msgs/Header, and return its frame. */
  header() {
    [this.int32(), this.uint32()]; // stamp
    return this.text();
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

/** Decode tf2_msgs/TFMessage: [{parent, child, translation, rotation}, …]. */
export function readTransforms(bytes) {
  const reader = new Reader(bytes);
  return Array.from({ length: reader.uint32() }, () => {
    const parent = reader.header();
    const child = reader.text();
    const [x, y, z, ...rotation] = Array.from({ length: 7 }, () => reader.float64());
    return { parent, child, translation: [x, y, z], rotation };
  });
}

/** Decode sensor_msgs/LaserScan as points: {frame, points}, x, y, z in metres and the range for the colour, of each beam that hit. */
export function readScan(bytes) {
  const reader = new Reader(bytes);
  const frame = reader.header();
  const [first, , step, , , least, most] = Array.from({ length: 7 }, () => reader.float32());
  const points = [];
  const count = reader.uint32();
  for (let beam = 0; beam < count; beam += 1) {
    const [range, angle] = [reader.float32(), first + beam * step];
    if (range >= least && range <= most) points.push(range * Math.cos(angle), range * Math.sin(angle), 0, range);
  }
  return { frame, points: new Float32Array(points) };
}

const [INT8, UINT8, INT16, UINT16, INT32, UINT32, FLOAT32, FLOAT64] = [1, 2, 3, 4, 5, 6, 7, 8]; // of sensor_msgs/PointField
const READERS = { [INT8]: "getInt8", [UINT8]: "getUint8", [INT16]: "getInt16", [UINT16]: "getUint16", [INT32]: "getInt32",
  [UINT32]: "getUint32", [FLOAT32]: "getFloat32", [FLOAT64]: "getFloat64" };

/** Decode sensor_msgs/PointCloud2: {frame, points}, x, y, z in metres and the height for the colour, without invalid points. */
export function readCloud(bytes, most = 500_000) {
  const reader = new Reader(bytes);
  const frame = reader.header();
  const [height, width] = [reader.uint32(), reader.uint32()];
  const fields = new Map();
  for (let left = reader.uint32(); left > 0; left -= 1) {
    const name = reader.text();
    fields.set(name, { offset: reader.uint32(), type: reader.uint8() });
    reader.uint32(); // count
  }
  const little = !reader.uint8();
  const [step] = [reader.uint32(), reader.uint32()];
  const data = reader.int8s();
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const axes = ["x", "y", "z"].map((name) => fields.get(name));
  if (axes.some((each) => !each || !(each.type in READERS))) throw new Error("this cloud has no fields x, y and z");
  const stride = Math.max(1, Math.ceil((height * width) / most)); // shows every n-th point of a very large cloud
  const points = new Float32Array(4 * Math.ceil((height * width) / stride));
  let used = 0;
  for (let at = 0; at + step <= data.length; at += step * stride) {
    const [x, y, z] = axes.map(({ offset, type }) => view[READERS[type]](at + offset, little));
    if (!Number.isFinite(x + y + z)) continue;
    points.set([x, y, z, z], used);
    used += 4;
  }
  return { frame, points: points.subarray(0, used) };
}

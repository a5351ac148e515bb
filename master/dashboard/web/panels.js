// Panels: what a map, an image, points in space or a topic shows, each with an element and an end. Pages and the page of
// panels put them together.

import { readCloud, readMap, readPath, readPose, readScan, readTransforms, readUpdate } from "./cdr.js";
import { typesOfTopics } from "./chooser.js";
import { h } from "./dom.js";
import { MapPicture } from "./mapview.js";
import { Picture } from "./picture.js";
import { Guest } from "./robot.js";
import { Space } from "./space.js";
import { Transforms } from "./tf.js";
import { canDecode, Video } from "./video.js";

const LATCHED = { reliability: "reliable", durability: "transient_local", depth: 1 };
const BEST_EFFORT = { depth: 5 };
const ORANGE = [1, 0.55, 0.2, 1];
const IMAGES = ["sensor_msgs/Image", "sensor_msgs/CompressedImage"];
const POSES = ["geometry_msgs/PoseWithCovarianceStamped", "geometry_msgs/PoseStamped"];

/** Kinds of panels: their name, the fields that say what they show, and how they are made. */
export const KINDS = {
  map: { label: "Map", make: mapPanel, fields: [
    { name: "topic", label: "Map", types: ["nav_msgs/OccupancyGrid"], value: "/map" },
    { name: "pose", label: "Pose", types: POSES, value: "/pose", optional: true },
    { name: "path", label: "Path", types: ["nav_msgs/Path"], value: "/path", optional: true }] },
  image: { label: "Image", make: imagePanel, fields: [{ name: "topic", label: "Topic", types: IMAGES, value: "/image_raw" }] },
  space: { label: "3D", make: spacePanel, fields: [
    { name: "scan", label: "Laser scan", types: ["sensor_msgs/LaserScan"], value: "/scan" },
    { name: "cloud", label: "Point cloud", types: ["sensor_msgs/PointCloud2"], value: "/points" }] },
};

/** A map with the robot's pose, trail and path. */
function mapPanel(app, owner, environment, { topic, pose, path }) {
  const picture = new MapPicture();
  const status = h("p.soft", { role: "status" }, "Waiting for a map …");
  const element = h("div", h("div.head", status, h("span.grow"), h("button", { onclick: () => picture.fit() }, "Whole map")), picture.element);
  const guest = new Guest(app, owner, environment);
  const take = (read, use) => ({ raw: true, depth: 1, callback: (bytes) => use(read(bytes)) });
  guest.subscribe(topic, "nav_msgs/OccupancyGrid", {
    qos: LATCHED, ...take(readMap, (map) => {
      picture.map(map);
      status.textContent = `${map.width} × ${map.height} cells of ${Math.round(map.resolution * 1000) / 10} cm`;
    }),
  }).catch((error) => { status.textContent = error.message; });
  // A node may lack these topics: then the map is shown without them.
  const optional = (promise) => promise.catch(() => {});
  optional(guest.subscribe(`${topic}_updates`, "map_msgs/OccupancyGridUpdate", { ...take(readUpdate, (update) => picture.update(update)), depth: 10 }));
  if (pose) optional(typesOfTopics(app, owner, environment).then((types) => guest.subscribe(pose, types.get(pose) ?? POSES[0], take(readPose, (at) => picture.pose(at)))));
  if (path) optional(guest.subscribe(path, "nav_msgs/Path", { qos: LATCHED, ...take(readPath, (poses) => picture.path(poses)) }));
  return { element, stop: () => { picture.stop(); guest.close(); } };
}

/** The images of a camera: as video where the browser and the platform can, else as JPEG. */
function imagePanel(app, owner, environment, { topic }) {
  const picture = new Picture();
  let guest = new Guest(app, owner, environment);
  const asFiles = (type) => guest.subscribe(topic, type, { format: "jpeg", depth: 1, qos: { depth: 1 }, callback: (message) => picture.take(message) });
  const video = new Video((frame) => picture.draw(frame, frame.displayWidth, frame.displayHeight), () => fallBack());
  let fallBack = () => {
    fallBack = () => {};
    guest.close();
    guest = new Guest(app, owner, environment);
    tell(asFiles(IMAGES[0]));
  };
  const tell = (promise) => promise.catch((error) => { picture.status.textContent = error.message; });
  tell(typesOfTopics(app, owner, environment).then((types) => {
    const type = types.get(topic) ?? IMAGES[0];
    if (type !== IMAGES[0] || !canDecode()) return asFiles(type);
    guest.onError(() => fallBack()); // these images are no video: depth, or of an odd size
    const callback = (packet) => video.take(packet);
    return guest.subscribe(topic, type, { codec: "h264", depth: 10, qos: { depth: 1 }, callback }).catch(() => fallBack());
  }));
  return { element: h("div", picture.status, picture.element), stop: () => { fallBack = () => {}; video.close(); guest.close(); } };
}

/** Laser scans and point clouds where /tf says that they are. */
function spacePanel(app, owner, environment, { scan, cloud }) {
  const status = h("p.soft", { role: "status" }, "Waiting for points …");
  let space;
  try {
    space = new Space();
  } catch (error) {
    return { element: h("p.error", error.message), stop: () => {} };
  }
  const guest = new Guest(app, owner, environment);
  const transforms = new Transforms();
  const shown = new Map();
  const draw = (name, { frame, points }, colour) => {
    const { root, matrix } = transforms.toRoot(frame);
    shown.set(name, `${name}: ${points.length / 4} points of ${frame} in ${root}`);
    space.set(name, points, { matrix, colour });
    status.textContent = [...shown.values()].join("; ");
  };
  const follow = (topic, type, qos, use) => topic && guest.subscribe(topic, type, { raw: true, depth: 1, qos, callback: (bytes) => {
    try {
      use(bytes);
    } catch (error) {
      status.textContent = `${topic}: ${error.message}`;
    }
  } }).catch((error) => { status.textContent = error.message; });
  const learn = (bytes) => readTransforms(bytes).forEach((each) => transforms.put(each));
  follow("/tf", "tf2_msgs/TFMessage", { depth: 100 }, learn);
  follow("/tf_static", "tf2_msgs/TFMessage", { ...LATCHED, depth: 100 }, learn);
  follow(scan, "sensor_msgs/LaserScan", BEST_EFFORT, (bytes) => draw("scan", readScan(bytes), ORANGE));
  follow(cloud, "sensor_msgs/PointCloud2", BEST_EFFORT, (bytes) => draw("cloud", readCloud(bytes)));
  return { element: h("div", status, space.element), stop: () => { space.stop(); guest.close(); } };
}

// Page of a map while it grows, with the robot's pose and trail.

import { readMap, readPath, readPose, readUpdate } from "./cdr.js";
import { h } from "./dom.js";
import { MapPicture } from "./mapview.js";
import { chooser, topicsOf } from "./chooser.js";
import { Subscriptions } from "./robot.js";

const LATCHED = { reliability: "reliable", durability: "transient_local", depth: 1 };

export function mapPage(main, app, owner, environment, query) {
  const pick = chooser(app, "map", owner, environment, [
    { name: "topic", label: "Map", type: "nav_msgs/OccupancyGrid", value: query.get("topic") ?? "/map" },
    { name: "pose", label: "Pose", type: "geometry_msgs/PoseWithCovarianceStamped", value: query.get("pose") ?? "/pose" },
    { name: "path", label: "Path", type: "nav_msgs/Path", value: query.get("path") ?? "/path" },
  ]);
  main.append(h("div.head", h("h1", "Map"), environment && h("span.soft", app.named(owner, environment))), pick.element);
  if (!environment) {
    main.append(h("p.soft", "Choose an environment whose nodes publish a map; what its interfaces make known is offered as topics."));
    return pick.stop;
  }
  app.reveal(owner);
  const picture = new MapPicture();
  const status = h("p.soft", { role: "status" }, "Waiting for a map …");
  main.append(h("section.panel", h("div.head", status, h("span.grow"), h("button", { onclick: () => picture.fit() }, "Whole map")), picture.element));
  const subscriptions = new Subscriptions(app, owner, environment);
  const { topic, pose, path } = pick.values();
  const all = { raw: true, depth: 1 };
  const take = (read, use) => ({ ...all, callback: (bytes) => use(read(bytes)) });
  subscriptions.add(topic, "nav_msgs/OccupancyGrid", {
    qos: LATCHED, ...take(readMap, (map) => {
      picture.map(map);
      status.textContent = `${map.width} × ${map.height} cells of ${Math.round(map.resolution * 1000) / 10} cm`;
    }),
  }).catch((error) => { status.textContent = error.message; });
  // A node may lack these topics: then the map is shown without them.
  const optional = (promise) => promise.catch(() => {});
  optional(subscriptions.add(`${topic}_updates`, "map_msgs/OccupancyGridUpdate", { ...take(readUpdate, (update) => picture.update(update)), depth: 10 }));
  if (pose) optional(subscriptions.add(pose, topicsOf(app, owner, environment).get(pose) ?? "geometry_msgs/PoseWithCovarianceStamped", take(readPose, (at) => picture.pose(at))));
  if (path) optional(subscriptions.add(path, "nav_msgs/Path", { qos: LATCHED, ...take(readPath, (poses) => picture.path(poses)) }));
  return () => { pick.stop(); picture.stop(); subscriptions.close(); };
}

// Page of the images of a camera.

import { h } from "./dom.js";
import { chooser, topicsOf } from "./chooser.js";
import { Picture } from "./picture.js";
import { Subscriptions } from "./robot.js";

export function imagePage(main, app, owner, environment, query) {
  const topic = query.get("topic") ?? "/image_raw";
  const pick = chooser(app, "image", owner, environment, [{ name: "topic", label: "Topic", type: "sensor_msgs/Image", value: topic }]);
  main.append(h("div.head", h("h1", "Image"), environment && h("span.soft", app.named(owner, environment))), pick.element);
  if (!environment) {
    main.append(h("p.soft", "Choose an environment whose nodes publish images; what its interfaces make known is offered as topics."));
    return pick.stop;
  }
  app.reveal(owner);
  const picture = new Picture();
  main.append(h("section.panel", picture.status, picture.element));
  const subscriptions = new Subscriptions(app, owner, environment);
  const type = topicsOf(app, owner, environment).get(topic) ?? "sensor_msgs/Image";
  subscriptions.add(topic, type, { format: "jpeg", depth: 1, qos: { depth: 1 }, callback: (message) => picture.take(message) })
    .catch((error) => { picture.status.textContent = error.message; });
  return () => { pick.stop(); subscriptions.close(); };
}

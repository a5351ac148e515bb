// Notice that the environment which a page shows has ended.

import { h } from "./dom.js";

/** Return {element, stop}: a warning that appears when the environment is gone, and goes when it is back. */
export function endedNotice(app, owner, environment) {
  const element = h("p.warning", { role: "status", hidden: true });
  let seen = false;
  const draw = () => {
    const there = app.live.environments.has(`${owner}/${environment}`);
    seen ||= there;
    element.hidden = there || !app.live.complete;
    if (element.hidden) return;
    const name = app.named(owner, environment);
    element.textContent = seen ? `The environment ${name} has ended: what is shown is the last that came.` : `There is no environment ${name}.`;
  };
  draw();
  return { element, stop: app.live.on(draw) };
}

// Pages that show one panel of an environment: map, image, points in space.

import { chooser, typesOfTopics } from "./chooser.js";
import { h } from "./dom.js";
import { endedNotice } from "./ended.js";
import { KINDS } from "./panels.js";

/** Return the page of one kind of panels, at the address `page`. */
export function viewPage(page, kind, hint) {
  const { label, make, fields } = KINDS[kind];
  return (main, app, owner, environment, query) => {
    const wanted = fields.map((each) => ({ ...each, value: query.get(each.name) ?? each.value }));
    const pick = chooser(app, page, owner, environment, wanted);
    main.append(h("div.head", h("h1", label), environment && h("span.soft", app.named(owner, environment))), pick.element);
    if (!environment) {
      main.append(h("p.soft", hint));
      return pick.stop;
    }
    app.reveal(owner);
    const ended = endedNotice(app, owner, environment);
    const section = h("section.panel");
    main.append(ended.element, section);
    let stop = () => {};
    const open = () => {
      const panel = make(app, owner, environment, pick.values());
      section.append(panel.element);
      stop = panel.stop;
    };
    if (fields.some((each) => query.has(each.name))) open();
    else typesOfTopics(app, owner, environment).then((types) => { if (section.isConnected) { pick.choose(types); open(); } });
    return () => { pick.stop(); ended.stop(); stop(); };
  };
}

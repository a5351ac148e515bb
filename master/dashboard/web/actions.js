// Panel of one action: a form to send a goal, its feedback and result, and a button that cancels it.

import { attempt, h } from "./dom.js";
import { brief, messageForm } from "./messages.js";

export function actionPanel(place, action, type) {
  const [feedback, result] = [h("pre.message"), h("pre.message")];
  const status = h("span.soft", { role: "status" });
  let goal = null;
  const cancel = h("button", { hidden: true, onclick: () => attempt(() => goal.cancel()) }, "Cancel goal");
  const run = async () => {
    for await (const each of goal) feedback.textContent = JSON.stringify(brief(each), null, 2);
    const ended = await goal.result();
    result.textContent = JSON.stringify(brief(ended.value), null, 2);
    status.textContent = ended.status;
  };
  const send = async (request) => {
    [feedback.textContent, result.textContent] = ["", ""];
    goal = await place.guest.sendGoal(action, type, request);
    [cancel.hidden, status.textContent] = [false, "accepted"];
    run().catch((error) => { status.textContent = error.message; }).finally(() => { cancel.hidden = true; });
    return "Sent";
  };
  const form = place.writes ? messageForm(place, type, "action", "Send goal", send) : h("p.soft", "Your role may not send goals here.");
  const element = h("section.panel", h("div.head", h("h2", action), h("span.soft", type), status, h("span.grow"), cancel), form,
    h("div.two", h("div", h("h3", "Feedback"), feedback), h("div", h("h3", "Result"), result)));
  return { element, stop: () => {} };
}

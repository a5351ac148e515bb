// First steps, shown while a user has neither robots nor environments: three ways to begin, with the lines to copy.

import { h, notice } from "./dom.js";
import { tell } from "./forms.js";

/** Return the panel of first steps. */
export function welcome(app) {
  const options = `--url ${location.origin}/ --user ${app.me.user}`;
  const password = "export RCE_PASSWORD='your password'";
  const steps = [
    ["Try a simulated robot", "A simulated robot drives through an apartment, and the cloud maps it. Run this where RCE is installed, "
      + "then open the page Map:", `${password}\nrce map --simulate ${options}`],
    ["Upload a recording", "The map service makes a map of a CARMEN log or a ROS bag:",
      `${password}\nrce map submit corridor.bag --wait --out corridor ${options}`],
    ["Connect a robot", "Create an API key on the page Keys, and run this program on the robot. It needs no ROS:", robot(app)],
  ];
  return h("section.panel.welcome", h("h2", "Nothing runs here yet"), h("p", "Three ways to begin:"),
    h("div.buttons", steps.map(([title, text, lines]) => h("button", { onclick: () => explain(title, text, lines) }, title))));
}

function explain(title, text, lines) {
  const copy = h("button.small", { onclick: () => navigator.clipboard?.writeText(lines).then(() => notice("Copied")) }, "Copy");
  tell(title, h("p", text), h("pre.message", lines), navigator.clipboard && copy);
}

function robot(app) {
  return `import asyncio
from rce.client import Robot


async def main():
    async with Robot("${location.origin}/", user="${app.me.user}", robot="r2d2", key="rce_…") as robot:
        async with robot.environment("brain") as brain:
            await brain.add_node("echo", "rce_demo", "echo")
            speak = await brain.publisher("/say", "std_msgs/String")
            listen = await brain.subscriber("/heard", "std_msgs/String")
            await speak.publish({"data": "hello cloud"})
            print(await listen.get())


asyncio.run(main())`;
}

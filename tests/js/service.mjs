// A robot that uses a service of the catalogue: node service.mjs URL USER PASSWORD SERVICE. Prints the answer to its message.

import { Robot } from "../../rce/js/rce.js";

const [url, user, password, name] = process.argv.slice(2);
const robot = new Robot(url, { user, robot: "script", password });
await robot.open();
const service = await robot.service(name, { tag: "parrot_js" });
const heard = service.subscriber("heard");
await service.publisher("say").publish({ data: "hello" });
for await (const { data } of heard) {
  console.log(JSON.stringify({ data, name: service.name, shared: service.shared }));
  break;
}
await service.leave();
await robot.close();

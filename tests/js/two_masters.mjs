// Connects a robot through the entries of several Masters (the URLs, separated by commas), and leaves.

import { Robot } from "../../rce/js/rce.js";

const [urls, user, password] = process.argv.slice(2);
const robot = new Robot(urls, { user, robot: "r2d2", password });
await robot.open();
await robot.close();
console.log("done");

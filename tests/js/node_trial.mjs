// node_trial.mjs URL: runs trial.js in this Node against the platform there.

import * as rce from "../../rce/js/rce.js";
import { run } from "./trial.js";

const passed = await run(rce, { url: process.argv[2], user: "testUser", password: "testUser", tag: "node" });
console.log(passed.join("\n"));

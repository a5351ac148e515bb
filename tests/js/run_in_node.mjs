// run_in_node.mjs URL [SKIP...]: runs client_contract.js in Node against the platform at URL, without the tests SKIP.

import * as rce from "../../rce/js/rce.js";
import { run } from "./client_contract.js";

const [url, ...skip] = process.argv.slice(2);
const passed = await run(rce, { url, user: "testUser", password: "testUser", tag: "node", skip });
console.log(passed.join("\n"));

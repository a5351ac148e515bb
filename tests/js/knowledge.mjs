// Uses the knowledge service at the URL that is given; prints "done" if all went well.

import assert from "node:assert/strict";
import { NotFound } from "../../rce/js/errors.js";
import { Knowledge } from "../../rce/js/knowledge.js";

const knowledge = new Knowledge(process.argv[2], { key: "rce_ann" });
const owl = "<http://example.org/k#cup1> a <http://example.org/k#Cup> .";
const entry = await knowledge.add({ kind: "object", class: "cup", id: "blue", owl });
assert.equal(entry.uid, "cup.blue");
await knowledge.putFile("object", "cup.blue", "cup.bin", new Uint8Array([1, 2, 3]));
assert.equal((await knowledge.file("object", "cup.blue", "cup.bin")).size, 3);
await knowledge.change("object", "cup.blue", { description: "new" });
assert.deepEqual((await knowledge.versions("object", "cup.blue")).map((each) => each.number), [3, 2, 1]);
assert.equal(await knowledge.owl("object", "cup.blue", 1), owl);
assert.equal((await knowledge.get("object", "cup.blue")).description, "new");
assert.ok((await knowledge.rate("object", "cup.blue", 10)).rating > 1);
const found = [];
for await (const each of knowledge.search({ class: "Cup" })) found.push(each.uid);
assert.deepEqual(found, ["cup.blue"]);
assert.equal((await knowledge.query("ASK { ?s a ?c }")).answer, true);
for await (const change of knowledge.changes({ prefix: "cup", after: 0 })) {
  assert.equal(change.action, "added");
  break;
}
await knowledge.remove("object", "cup.blue");
await assert.rejects(knowledge.get("object", "cup.blue"), NotFound);
console.log("done");
process.exit(0);

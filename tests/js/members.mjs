// Prints the members of the client's classes as JSON, for comparison with rce.d.ts.

import * as rce from "../../rce/js/rce.js";

const robot = new rce.Robot("http://localhost:1/", { user: "ann", robot: "r", key: "rce_0", WebSocket: class {} });
const instances = {
  Robot: robot, Environment: robot.environment("brain"), Stream: new rce.Stream(1), RceError: new rce.RceError("wrong"),
};
const members = (found) => {
  const names = new Set(Object.keys(found));
  for (let at = found; at && at !== Object.prototype; at = Object.getPrototypeOf(at)) {
    for (const name of Object.getOwnPropertyNames(at)) names.add(name);
  }
  return [...names];
};
const errors = Object.entries(rce).filter(([, kind]) => kind.prototype instanceof rce.RceError).map(([name]) => name);
const own = Object.fromEntries(Object.entries(instances).map(([name, found]) => [name, members(found)]));
console.log(JSON.stringify({ errors, members: own }));

// Service of the platform's catalogue, as one robot uses it; made by `Robot.service`.

import { ActionClient } from "./actions.js";
import { NotFound } from "./errors.js";
import { Publisher, ServiceClient, Subscriber } from "./interfaces.js";

const KINDS = { Subscriber: Publisher, Publisher: Subscriber, ServiceProvider: ServiceClient, ActionProvider: ActionClient };

/** The robot's interfaces for a service are in `interfaces`, by the names in its declaration. */
export class Service {
  #robot;

  /** `used` is what the platform answered. */
  constructor(robot, used) {
    this.#robot = robot;
    [this.name, this.tag, this.shared] = [used.service, used.containerTag, used.shared];
    this.interfaces = new Map(used.interfaces.map((each) => {
      const Kind = KINDS[each.interfaceType.replace(/Converter$|Forwarder$/, "")];
      return [each.name, new Kind(robot, each.iTag, each.className, {})];
    }));
  }

  publisher(name) {
    return this.#find(name, Publisher);
  }

  subscriber(name) {
    return this.#find(name, Subscriber);
  }

  serviceClient(name) {
    return this.#find(name, ServiceClient);
  }

  actionClient(name) {
    return this.#find(name, ActionClient);
  }

  /** Use the service no longer: its interfaces are removed; reads and calls that wait end at once. */
  leave() {
    return this.#robot.leaveService(this);
  }

  #find(name, kind) {
    const found = this.interfaces.get(name);
    if (found instanceof kind) return found;
    throw new NotFound(`${this.name} has no ${kind.name} ${name}; it has ${[...this.interfaces.keys()].join(", ")}`);
  }
}

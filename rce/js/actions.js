// Action clients and action servers of a robot, made by the methods of Robot and Environment.

import { CONNECT_TIMEOUT, Interface, valueOf } from "./interfaces.js";
import { Forbidden, NotFound, RceError, TimedOut, Unavailable, within } from "./errors.js";
import { Stream } from "./stream.js";
import { freshId } from "./values.js";

const FEEDBACK_DEPTH = 100; // unread feedback of a goal that is kept

/** A promise with its `resolve` and `reject`; it may stay unread. */
function deferred() {
  const made = {};
  made.promise = new Promise((resolve, reject) => Object.assign(made, { resolve, reject }));
  made.promise.catch(() => {});
  return made;
}

/** A goal that was accepted. Iterate over it with `for await` to get its feedback, until it ends. */
export class Goal {
  feedback = new Stream(FEEDBACK_DEPTH);
  accepted = deferred();
  canceling = null;
  #client;
  #ended = false;
  #result = deferred();

  constructor(client, id) {
    this.#client = client;
    this.id = id;
  }

  [Symbol.asyncIterator]() {
    return this.feedback[Symbol.asyncIterator]();
  }

  /** The end of the goal: `{status, value}`. Rejects with the error with which it failed, or TimedOut. */
  result(timeout = Infinity) {
    const late = () => new TimedOut(`the goal of ${this.#client.tag} did not end within ${timeout} s`);
    return timeout < Infinity ? within(this.#result.promise, timeout, late) : this.#result.promise;
  }

  /** Ask the server to cancel the goal. Rejects with Forbidden if it does not, and NotFound if the goal has ended. */
  async cancel(timeout = CONNECT_TIMEOUT) {
    if (this.#ended) throw new NotFound(`the goal of ${this.#client.tag} has ended: it cannot be canceled`);
    await this.#client.waitConnected(timeout);
    if (!this.canceling) {
      this.canceling = deferred();
      this.#client.report(this.id, "cancel");
    }
    await within(this.canceling.promise, timeout, () => new TimedOut(
      `action ${this.#client.tag} did not answer within ${timeout} s`));
  }

  // Called by the action client.

  set({ phase, status }, value) {
    if (phase === "accepted" || phase === "rejected") this.accepted.resolve(phase === "accepted");
    else if (phase === "feedback") this.feedback.put(value);
    else if (phase === "cancel") this.canceling?.resolve();
    else if (phase === "result") {
      this.accepted.resolve(true);
      if (status === "canceled") this.canceling?.resolve(); // its end may overtake the answer to the request
      this.#result.resolve({ status, value });
      this.#finish();
    }
  }

  fail(error) {
    this.accepted.reject(error);
    this.#result.reject(error);
    this.#finish();
  }

  notCanceled(error) {
    this.canceling?.reject(error);
    this.canceling = null;
  }

  #finish() {
    this.#ended = true;
    this.notCanceled(new Unavailable("the goal has ended"));
    this.feedback.end();
  }
}

/** Sends goals to an action server. When the robot is back after its socket broke, it asks for their results. */
export class ActionClient extends Interface {
  #goals = new Map();
  #stale = false;

  /**
   * Send a goal, and wait until the server has accepted it. Rejects with Forbidden if the server rejects it, and with
   * TimedOut, after which the goal is canceled. With `cancelIfLost` it is canceled when the robot's session ends.
   */
  async sendGoal(goal, { timeout = CONNECT_TIMEOUT, cancelIfLost = false } = {}) {
    await this.waitConnected(timeout);
    const sent = new Goal(this, freshId());
    this.#goals.set(sent.id, sent);
    let accepted;
    try {
      this.report(sent.id, "goal", { msg: goal, ...(cancelIfLost ? { ifLost: "cancel" } : {}) });
      accepted = await within(sent.accepted.promise, timeout, () => new TimedOut(
        `action ${this.tag} (${this.typeName}) did not answer within ${timeout} s`));
    } catch (error) {
      if (this.#goals.delete(sent.id) && error instanceof TimedOut) this.report(sent.id, "cancel");
      throw error;
    }
    if (accepted) return sent;
    this.#goals.delete(sent.id);
    throw new Forbidden(`action ${this.tag} (${this.typeName}) rejected the goal`);
  }

  receive(data, blobs) {
    const goal = this.#goals.get(data.msgID);
    if (data.phase === "result") this.#goals.delete(data.msgID);
    goal?.set(data, valueOf(data, blobs));
  }

  failCall(error, msgId) {
    const goal = this.#goals.get(msgId);
    if (!goal) return false;
    if (error.fields?.phase === "cancel") goal.notCanceled(error);
    else {
      this.#goals.delete(msgId);
      goal.fail(error);
    }
    return true;
  }

  setStatus(connected) {
    super.setStatus(connected);
    if (!this.#stale || !this.connected) return;
    this.#stale = false;
    for (const id of this.#goals.keys()) this.report(id, "result");
  }

  disconnected() {
    super.disconnected();
    this.#stale = true;
    const error = new Unavailable("the socket broke: it is not known whether the goal is being canceled");
    for (const goal of this.#goals.values()) goal.notCanceled(error);
  }

  end(error) {
    super.end(error);
    for (const goal of this.#goals.values()) goal.fail(error ?? new Unavailable("the robot has been closed"));
    this.#goals.clear();
  }
}

/**
 * Carries out goals: `handler` gets `{id, request, signal, publishFeedback}`, and its result is that of the goal. When
 * the goal is to be canceled, `signal` aborts, and what the handler returns or throws then ends a canceled goal.
 */
export class ActionServer extends Interface {
  #running = new Map(); // AbortController by goal id

  constructor(robot, tag, typeName, handler, accept = () => true) {
    super(robot, tag, typeName);
    this.handler = handler;
    this.accept = accept;
  }

  receive(data, blobs) {
    if (data.phase === "cancel") return this.#cancel(data.msgID);
    if (data.phase === "goal") return this.#start(data.msgID, valueOf(data, blobs));
  }

  #cancel(id) {
    const running = this.#running.get(id);
    this.report(id, "cancel", running ? {} : { error: "the goal has ended" });
    running?.abort();
  }

  async #start(id, request) {
    if (!this.accept(request)) return void this.report(id, "rejected");
    this.report(id, "accepted");
    const abort = new AbortController();
    this.#running.set(id, abort);
    const publishFeedback = (value) => this.report(id, "feedback", { msg: value });
    let end;
    try {
      const value = await this.handler({ id, request, signal: abort.signal, publishFeedback });
      end = { status: abort.signal.aborted ? "canceled" : "succeeded", msg: value };
    } catch (error) {
      if (abort.signal.aborted) end = { status: "canceled" };
      else {
        const text = error instanceof RceError ? error.message : `${error?.name ?? "Error"}: ${error?.message}`;
        end = { status: "aborted", error: text };
      }
    }
    this.#running.delete(id);
    while (!this.connected && !this.ended) await this.waitConnected(3600).catch(() => {});
    this.report(id, "result", end);
  }
}

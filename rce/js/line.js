// Watches whether the line to a Robot endpoint is dead, by the robot's own traffic: a page cannot send pings.

const LOOK = 250; // milliseconds between two looks
const PATIENCE = 2; // seconds, and four round trips, for an answer
const LOOKS = 2; // at which the answer is overdue
const SLOWEST = 30_000; // bytes a second that a line carries: what was sent before must arrive first

/** After something was sent, sends a probe, and calls `dead` if neither its answer nor anything else comes in time. */
export class LineWatch {
  #probe;
  #dead;
  #timer;
  #unanswered = 0; // bytes that were sent before the probe, or since the last answer
  #since = 0; // bytes that were sent after the probe
  #probed = 0; // time of the probe that has no answer yet
  #heard = 0; // time at which something came last
  #overdue = 0; // looks at which it was: after a pause of the page, the answer may wait behind the first one
  roundTrip = 0; // seconds, of the last probe

  constructor(probe, dead) {
    this.#probe = probe;
    this.#dead = dead;
    this.#timer = setInterval(() => this.#look(), LOOK);
    this.#timer.unref?.(); // in Node: the watch does not keep a program running
  }

  /** Note that this many bytes were sent. */
  sent(bytes) {
    if (this.#probed) this.#since += bytes;
    else this.#unanswered += bytes;
  }

  /** Note that something came. */
  heard() {
    this.#heard = performance.now();
  }

  /** Note that the answer to the probe came. */
  answered() {
    this.roundTrip = (performance.now() - this.#probed) / 1000;
    [this.#unanswered, this.#since, this.#probed] = [this.#since, 0, 0];
  }

  /** Seconds to wait for an answer on this line. */
  get patience() {
    return PATIENCE + 4 * this.roundTrip + this.#unanswered / SLOWEST;
  }

  stop() {
    clearInterval(this.#timer);
  }

  #look() {
    const now = performance.now();
    if (!this.#probed) {
      if (!this.#unanswered) return;
      this.#probed = now;
      this.#probe();
      return;
    }
    const late = now - Math.max(this.#probed, this.#heard) > 1000 * this.patience;
    this.#overdue = late ? this.#overdue + 1 : 0;
    if (this.#overdue < LOOKS) return;
    this.stop();
    this.#dead();
  }
}

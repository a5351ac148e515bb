// The signed-in user and their rights, by which pages offer actions; the server enforces them.

export class Person {
  /** `whoami` is the server's answer: user, role, key, and rights (`own`, `all` or `-` by operation). */
  constructor(whoami) {
    Object.assign(this, whoami);
  }

  /** Return whether the user may do this operation on resources of `owner`: a user, or `*` for all. */
  may(operation, owner = this.user) {
    const reach = this.rights[operation];
    return reach === "all" || (reach === "own" && owner === this.user);
  }
}

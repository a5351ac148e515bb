// Who is signed in, and what they may do: the page offers that; the server decides.

export class Person {
  /** `whoami` is the server's answer: user, role, key, rights (`own`, `all` or `-` by operation). */
  constructor(whoami) {
    Object.assign(this, whoami);
  }

  /** Whether the operation is theirs to do on what is `owner`'s: a user, or `*` for everybody. */
  may(operation, owner = this.user) {
    const reach = this.rights[operation];
    return reach === "all" || (reach === "own" && owner === this.user);
  }
}

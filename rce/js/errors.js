// Errors with the classes and codes of rce/errors.py.

/** Base of all errors. */
export class RceError extends Error {
  static code = "error";

  /** `item` is `list[index]` of the item of a command, `field` the path of the field at fault, `fields` the details. */
  constructor(message, { code, item = "", field = "", fields = {} } = {}) {
    super(message);
    this.code = code ?? new.target.code;
    this.item = item;
    this.field = field;
    this.fields = fields;
  }

  get name() {
    return this.constructor.name;
  }

  /** Create an error of the class for its code; a code that this version does not know is kept in a plain RceError. */
  static of(info) {
    return new (kinds[info.code] ?? RceError)(info.message, info);
  }
}

export class InvalidRequest extends RceError { static code = "invalid_request"; }
export class InvalidName extends InvalidRequest { static code = "invalid_name"; }
export class ConversionError extends InvalidRequest { static code = "conversion"; }
export class UnknownType extends InvalidRequest { static code = "unknown_type"; }
export class NotFound extends RceError { static code = "not_found"; }
export class AlreadyExists extends RceError { static code = "already_exists"; }
export class NotConnectable extends RceError { static code = "not_connectable"; }
export class NotConnected extends RceError { static code = "not_connected"; }
export class Unauthorized extends RceError { static code = "unauthorized"; }
export class TooManyAttempts extends RceError { static code = "too_many_attempts"; }
export class Forbidden extends RceError { static code = "forbidden"; }
export class NoCapacity extends RceError { static code = "no_capacity"; }
export class LimitExceeded extends RceError { static code = "limit_exceeded"; }
export class StartFailed extends RceError { static code = "start_failed"; }
export class Died extends RceError { static code = "died"; }
export class Unavailable extends RceError { static code = "unavailable"; }
export class Lost extends Unavailable { static code = "lost"; }
export class TimedOut extends RceError { static code = "timed_out"; }
export class InternalError extends RceError { static code = "internal"; }

const kinds = Object.fromEntries(
  [InvalidRequest, InvalidName, ConversionError, UnknownType, NotFound, AlreadyExists, NotConnectable, NotConnected,
    Unauthorized, TooManyAttempts, Forbidden, NoCapacity, LimitExceeded, StartFailed, Died, Unavailable, Lost, TimedOut,
    InternalError]
    .map((kind) => [kind.code, kind]));

const byStatus = {
  400: InvalidRequest, 401: Unauthorized, 403: Forbidden, 404: NotFound, 409: AlreadyExists, 410: InvalidRequest,
  500: InternalError, 501: InvalidRequest,
};

/** Return the error for an HTTP status of the entry or the handshake. */
export function refusal(status, reason) {
  return new (byStatus[status] ?? Unavailable)(reason.trim().slice(0, 500) || `HTTP status ${status}`);
}

/** Settle like `promise`, or reject after `seconds` with the error that `makeError` returns. */
export function within(promise, seconds, makeError) {
  let timer;
  const limit = new Promise((_, reject) => {
    timer = setTimeout(() => reject(makeError()), Math.min(seconds * 1000, 2 ** 31 - 1));
  });
  return Promise.race([promise, limit]).finally(() => clearTimeout(timer));
}

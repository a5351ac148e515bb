/** The client library of RCE: a robot at the platform. All times are in seconds. See docs/javascript.md. */

export class RceError extends Error {
  readonly code: string;
  /** `list[index]` of the command's item. */
  item: string;
  /** Path of the field at fault, `pose.position.x`. */
  readonly field: string;
  readonly fields: Record<string, string | number | boolean | string[]>;
}
export class InvalidRequest extends RceError {}
export class InvalidName extends InvalidRequest {}
export class ConversionError extends InvalidRequest {}
export class UnknownType extends InvalidRequest {}
export class NotFound extends RceError {}
export class AlreadyExists extends RceError {}
export class NotConnectable extends RceError {}
export class NotConnected extends RceError {}
export class Unauthorized extends RceError {}
export class Forbidden extends RceError {}
export class NoCapacity extends RceError {}
export class LimitExceeded extends RceError {}
export class StartFailed extends RceError {}
export class Died extends RceError {}
export class Unavailable extends RceError {}
export class Lost extends Unavailable {}
export class TimedOut extends RceError {}
export class InternalError extends RceError {}

/** A message: an object as its ROS type (bytes as Uint8Array), or the bytes of an image or of a `raw` interface. */
export type Message = Record<string, any> | Uint8Array;
export type ParameterValue = boolean | number | bigint | string | (boolean | number | bigint | string)[];
export type InterfaceType = `${"Publisher" | "Subscriber" | "ServiceClient" | "ServiceProvider"}${
  "Interface" | "Converter" | "Forwarder"}`;

export interface Qos {
  reliability?: "auto" | "reliable" | "best_effort";
  durability?: "auto" | "volatile" | "transient_local";
  history?: "keep_last" | "keep_all";
  depth?: number;
}

/** `containerData` of docs/protocol.md. */
export interface EnvironmentOptions {
  image?: string;
  size?: number;
  cpu?: number;
  memory?: number;
  pids?: number;
  disk?: number;
  bandwidth?: number;
  io?: { read?: number; write?: number };
  gpus?: number;
  specialFeatures?: string[];
  env?: Record<string, string>;
  packages?: string[];
  group?: string;
  groupIP?: string;
  restart?: "always" | "no";
}

export type Event =
  | { topic: "environment"; containerTag: string; state: "ready" | "failed" | "lost" | "gone"; reason?: string;
      address?: string }
  | { topic: "node"; containerTag: string; nodeTag: string; status: number; lines?: string[] }
  | { topic: "drops"; iTag: string; count: number; where: string }
  | { topic: "limit"; reason: string }
  | { topic: "disconnected"; reason: string }
  | { topic: "reconnected"; resumed: boolean }
  /** One that answers no command. */
  | { topic: "error"; error: RceError };

/** A bounded queue that keeps the newest. */
export class Stream<T> implements AsyncIterable<T> {
  constructor(depth: number);
  readonly dropped: number;
  put(item: T): void;
  end(error?: Error | null): void;
  get(timeout?: number): Promise<T>;
  [Symbol.asyncIterator](): AsyncIterator<T>;
}

interface Interface {
  readonly tag: string;
  readonly typeName: string;
  /** Whether it has a peer, at a platform that can be reached. */
  readonly connected: boolean;
  waitConnected(timeout?: number): Promise<void>;
  close(): Promise<void>;
}

export interface Publisher extends Interface {
  readonly dropped: number;
  /** Waits for a peer and for room. NotConnected after `timeout`. */
  publish(value: Message, timeout?: number): Promise<void>;
  /** Without waiting: at most `keep` wait, older ones are dropped. False if there is no peer. */
  offer(value: Message, keep?: number): boolean;
}

export interface Subscriber<T = any> extends Interface, AsyncIterable<T> {
  readonly dropped: number;
  get(timeout?: number): Promise<T>;
}

export interface ServiceClient extends Interface {
  call(request: Message, timeout?: number): Promise<any>;
}

export interface ServiceProvider extends Interface {}

export interface InterfaceOptions {
  /** The interface holds serialized ROS messages (CDR). */
  raw?: boolean;
  /** How images travel. */
  format?: "png" | "jpeg" | "json";
  qos?: Qos;
}
export interface SubscriberOptions<T = any> extends InterfaceOptions {
  depth?: number;
  callback?: (message: T) => void;
}
/** `to` is the `endpoint/interface` that is connected at once. */
export type To = { to?: string };
export type Handler = (request: any) => Message | Promise<Message>;

export class Environment {
  readonly robot: Robot;
  readonly tag: string;
  create(options?: { existOk?: boolean }): Promise<void>;
  destroy(): Promise<void>;
  addNode(tag: string, pkg: string, exe: string, options?: NodeOptions): Promise<void>;
  removeNode(tag: string): Promise<void>;
  setParameter(name: string, value: ParameterValue, options?: { node?: string }): Promise<void>;
  deleteParameter(name: string, options?: { node?: string }): Promise<void>;
  publisher(topic: string, typeName: string, options?: InterfaceOptions): Promise<Publisher>;
  subscriber<T = any>(topic: string, typeName: string, options?: SubscriberOptions<T>): Promise<Subscriber<T>>;
  serviceClient(service: string, typeName: string, options?: { raw?: boolean }): Promise<ServiceClient>;
  serviceProvider(service: string, typeName: string, handler: Handler, options?: { raw?: boolean }):
    Promise<ServiceProvider>;
}

export interface NodeOptions {
  /** May use `$(find PKG)` and `$(env VAR)`. */
  args?: string;
  name?: string;
  namespace?: string;
}

/** `[list, item]` in the protocol's words: `["addNodes", {containerTag: …}]`, `["CC", {…}]`, `["connect", {…}]`. */
export type Command = [
  "CC" | "DC" | "addNodes" | "removeNodes" | "addInterfaces" | "removeInterfaces" | "setParam" | "deleteParam"
    | "connect" | "disconnect",
  Record<string, unknown>,
];

export interface RobotOptions {
  user: string;
  /** One that begins with `@` is a guest's: what it makes goes with it. */
  robot: string;
  /** Whose guest it is; the user's own if it is left out. */
  owner?: string;
  /** An API key, or the password in clear (its SHA-256 is sent; needs a page from https or localhost). */
  key?: string;
  password?: string;
  /** For each command. */
  timeout?: number;
  WebSocket?: typeof WebSocket;
}

export class Robot {
  constructor(url: string, options: RobotOptions);
  readonly name: string;
  readonly isGuest: boolean;
  readonly connected: boolean;
  readonly features: Set<string>;
  open(): Promise<void>;
  close(): Promise<void>;
  events(): Stream<Event>;
  environment(tag: string, options?: EnvironmentOptions): Environment;

  createEnvironment(tag: string, options?: EnvironmentOptions, how?: { existOk?: boolean }): Promise<void>;
  destroyEnvironment(tag: string): Promise<void>;
  addNode(environment: string, tag: string, pkg: string, exe: string, options?: NodeOptions): Promise<void>;
  removeNode(environment: string, tag: string): Promise<void>;
  setParameter(environment: string, name: string, value: ParameterValue, options?: { node?: string }): Promise<void>;
  deleteParameter(environment: string, name: string, options?: { node?: string }): Promise<void>;
  addInterface(endpoint: string, tag: string, interfaceType: InterfaceType, typeName: string,
    options?: { addr?: string; qos?: Qos; format?: "png" | "jpeg" | "json" }): Promise<void>;
  removeInterface(endpoint: string, tag: string): Promise<void>;
  connect(a: string, b: string): Promise<void>;
  disconnect(a: string, b: string): Promise<void>;
  configure(...commands: Command[]): Promise<void>;

  publisher(tag: string, typeName: string, options?: InterfaceOptions & To): Promise<Publisher>;
  subscriber<T = any>(tag: string, typeName: string, options?: SubscriberOptions<T> & To): Promise<Subscriber<T>>;
  serviceClient(tag: string, typeName: string, options?: { raw?: boolean } & To): Promise<ServiceClient>;
  serviceProvider(tag: string, typeName: string, handler: Handler, options?: { raw?: boolean } & To):
    Promise<ServiceProvider>;
}

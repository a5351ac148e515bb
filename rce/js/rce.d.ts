/**
 * JavaScript client library of RCE: a robot that is connected to a platform. All times are in seconds. See
 * docs/javascript.md.
 */

/** Base of all errors. Every error has a `code`, which programs test, and a message for people. */
export class RceError extends Error {
  /** Code of the error, for example `not_found`; kept even if this version does not know it. */
  readonly code: string;
  /** Item of the command that failed, `list[index]`; empty if there was one only. */
  item: string;
  /** Path of the field at fault, for example `pose.position.x`. */
  readonly field: string;
  /** Details, such as the limit that was exceeded. */
  readonly fields: Record<string, string | number | boolean | string[]>;
}
/** A malformed frame, command or option. Repeating it gives the same error. */
export class InvalidRequest extends RceError {}
/** A tag or name that breaks the naming rule: an ASCII letter, then ASCII letters, digits or `_`. */
export class InvalidName extends InvalidRequest {}
/** A message that does not fit its ROS type; `field` is the path of the field. */
export class ConversionError extends InvalidRequest {}
/** A message or service type that the platform does not know. */
export class UnknownType extends InvalidRequest {}
/** The thing that the command names does not exist, or belongs to another user. */
export class NotFound extends RceError {}
/** The tag is in use. */
export class AlreadyExists extends RceError {}
/** The two interfaces are not a pair: their kinds are not opposites, or their types differ. */
export class NotConnectable extends RceError {}
/** The interface has no peer. */
export class NotConnected extends RceError {}
/** Credentials are missing, wrong, expired or revoked. */
export class Unauthorized extends RceError {}
/** The credentials are valid, but do not permit this. */
export class TooManyAttempts extends RceError {}
export class Forbidden extends RceError {}
/** No machine has room. */
export class NoCapacity extends RceError {}
/** More than this user, robot or message may have; `fields` has the limit. */
export class LimitExceeded extends RceError {}
/** An environment or node did not start; the message has the reason and the last lines of its output. */
export class StartFailed extends RceError {}
/** A running environment or node ended unexpectedly; the message has its exit status. */
export class Died extends RceError {}
/** The platform, or a part of it, cannot be reached at present, or the robot is not open. */
export class Unavailable extends RceError {}
/** The connection broke before the answer: the call may or may not have been executed. */
export class Lost extends Unavailable {}
/** There was no answer in time; the command may have been executed. */
export class TimedOut extends RceError {}
/** A bug in the platform or the client. */
export class InternalError extends RceError {}

/**
 * A message: an object with the fields of its ROS type, or the bytes of an image or of a `raw` interface. Byte arrays
 * may be sent as Uint8Array and arrive as base64 strings.
 */
export type Message = Record<string, any> | Uint8Array;
/** Value of a parameter; nodes read what ROS 2 has no type for as YAML text. */
export type ParameterValue = boolean | number | bigint | string | ParameterItem[] | { [key: string]: ParameterItem };
export type ParameterItem = ParameterValue | null;
/** Kind of an interface: `...Interface` in an environment, `...Converter` or `...Forwarder` (raw) at a robot. */
export type InterfaceType = `${"Publisher" | "Subscriber" | "ServiceClient" | "ServiceProvider" | "ActionClient" | "ActionProvider"}${
  "Interface" | "Converter" | "Forwarder"}`;

/** ROS 2 quality of service. */
export interface Qos {
  reliability?: "auto" | "reliable" | "best_effort";
  durability?: "auto" | "volatile" | "transient_local";
  history?: "keep_last" | "keep_all";
  /** Messages that may wait; by default 1000, of images and point clouds 10, and no more than 16 MB. */
  depth?: number;
}

/** Treatment of the messages of a topic on the line between the robot and the platform. */
export interface Delivery {
  /** Messages of a higher priority are sent first. */
  priority?: "high" | "normal" | "low";
  /** Seconds: a message that is older when its turn comes is dropped and counted. */
  maxAge?: number;
  /** Messages a second, at most. */
  rate?: number;
  /** Paths of the only fields that messages to the robot have, such as `header.stamp`. */
  fields?: string[];
  /** Fewer beams, points or pixels in messages to the robot: each `step`-th, or an image that fits into `size`. */
  decimate?: { step?: number; size?: [width: number, height: number] };
}

/** Options of an environment: `containerData` of docs/protocol.md, which has the defaults. */
export interface EnvironmentOptions {
  /** Container image, one of those that the user may use. */
  image?: string;
  /** Slots of a machine. */
  size?: number;
  /** Cores, also fractions. */
  cpu?: number;
  /** Bytes. */
  memory?: number;
  /** Processes and threads. */
  pids?: number;
  /** Bytes of the home directory. */
  disk?: number;
  /** Bytes per second that the environment may send. */
  bandwidth?: number;
  /** Bytes per second from and to its disk. */
  io?: { read?: number; write?: number };
  gpus?: number;
  /** Features that the machine must offer. */
  specialFeatures?: string[];
  /** Environment variables of the nodes. */
  env?: Record<string, string>;
  /** Secrets of the user, each with the variable that nodes get, or "" for a file only. */
  secrets?: Record<string, string>;
  /** Users' own packages: `name` or `user/name`, optionally with `@version`. */
  packages?: string[];
  /** Network group to join. */
  group?: string;
  /** Address in the network group. */
  groupIP?: string;
  /** `always` starts an environment that dies again with all that it had. */
  restart?: "always" | "no";
}

/** Event of a robot, distinguished by its `topic`. */
export type Event =
  | { topic: "environment"; containerTag: string; state: "ready" | "failed" | "lost" | "gone"; reason?: string;
      address?: string }
  /** A node ended, with its exit status and the last lines of its output. */
  | { topic: "node"; containerTag: string; nodeTag: string; status: number; lines?: string[] }
  /** The platform dropped messages of an interface. */
  | { topic: "drops"; iTag: string; count: number; where: string }
  /** A connection that the robot made waits for an end that is away, is restored, or is gone. */
  | { topic: "connection"; tagA: string; tagB: string; state: "waiting" | "restored" | "gone"; reason?: string }
  /** A recorder ended by itself. */
  | { topic: "recorder"; containerTag: string; recorderTag: string; reason: string }
  | { topic: "limit"; reason: string }
  /** The socket broke; the robot reconnects by itself. */
  | { topic: "disconnected"; reason: string }
  /** Connected again; unless `resumed`, the robot is declaring its interfaces and connections again. */
  | { topic: "reconnected"; resumed: boolean }
  /** An error that answers no command. */
  | { topic: "error"; error: RceError };

/** Bounded queue that keeps the newest items, read with `for await` or `get`. */
export class Stream<T> implements AsyncIterable<T> {
  /** Create an empty stream that keeps `depth` unread items; `left` is called when a `for await` loop is left. */
  constructor(depth: number, left?: () => void);
  /** Number of items that were dropped because too many were unread. */
  readonly dropped: number;
  /** True after `end`. */
  readonly ended: boolean;
  /** Add an item, and drop the oldest one if there are too many. */
  put(item: T): void;
  /** End the stream: readers get the remaining items, then the end of the iteration or `error`. */
  end(error?: Error | null): void;
  /** The next item. Rejects with TimedOut after `timeout`, and after the end with its error or Unavailable. */
  get(timeout?: number): Promise<T>;
  [Symbol.asyncIterator](): AsyncIterator<T>;
}

/** Common part of publishers, subscribers, service clients and service providers. */
interface Interface {
  /** Name of the interface, unique within the robot. */
  readonly tag: string;
  /** ROS message or service type. */
  readonly typeName: string;
  /** True while the robot is online and the interface has a peer that is online too. */
  readonly connected: boolean;
  /** True once it has had a peer, which may be gone again. */
  readonly wasConnected: boolean;
  /** Wait until the interface has a peer. Rejects with NotConnected after `timeout` (10 by default). */
  waitConnected(timeout?: number): Promise<void>;
  /** Remove the interface and its connections. */
  close(): Promise<void>;
}

/**
 * Sends messages. Those that had not reached the platform when the socket broke are lost, unless the option `offline`
 * keeps them; none arrives twice.
 */
export interface Publisher extends Interface {
  /** Number of messages that were dropped. */
  readonly dropped: number;
  /**
   * Send a message; waits for a peer and for room in the send queue (back-pressure), also while the robot is offline.
   * Rejects with NotConnected after `timeout` without a peer, and with InvalidRequest for a value without JSON. With
   * `offline: "newest"` or `"store"` it resolves when the platform has the message. With `wait` false it returns at
   * once, and `offline` says what becomes of a message that cannot be sent now.
   */
  publish(value: Message, timeout?: number, wait?: boolean): Promise<void>;
  /**
   * Send a message without waiting, so that at most `keep` (1 by default) wait in the send queue; the oldest are
   * dropped. Returns false if it was dropped because there is no peer or the robot is offline.
   */
  offer(value: Message, keep?: number): boolean;
}

/** Receives messages: iterate with `for await`, `get` the next one, or give a callback. */
export interface Subscriber<T = any> extends Interface, AsyncIterable<T> {
  /** Number of messages that were dropped because more than `depth` were unread. */
  readonly dropped: number;
  /** The next message. Rejects with TimedOut after `timeout`, and with Unavailable after the end. */
  get(timeout?: number): Promise<T>;
}

/** Calls a service. */
export interface ServiceClient extends Interface {
  /**
   * Call the service and return its response. Rejects with NotConnected or TimedOut after `timeout` (10 by default),
   * with Unavailable if the socket breaks meanwhile (the call may have been executed), and with the service's error.
   */
  call(request: Message, timeout?: number): Promise<any>;
}

/** Answers the calls of a service with its handler. */
export interface ServiceProvider extends Interface {}

/** End of a goal: how it ended, and the value of its result. */
export interface GoalResult {
  status: "succeeded" | "canceled" | "aborted";
  value: any;
}

/** A goal that was accepted: iterate with `for await` over its feedback, until it ends. */
export interface Goal extends AsyncIterable<any> {
  /** UUID, 32 hex digits. */
  readonly id: string;
  /** The end of the goal. Rejects with the error with which it failed, and with TimedOut after `timeout` seconds. */
  result(timeout?: number): Promise<GoalResult>;
  /** Ask the server to cancel the goal. Rejects with Forbidden if it does not, with NotFound if the goal has ended. */
  cancel(timeout?: number): Promise<void>;
}

/** Sends goals to an action server. */
export interface ActionClient extends Interface {
  /**
   * Send a goal, and wait until the server has accepted it. Rejects with Forbidden if the server rejects it, and with
   * TimedOut after `timeout` (10 by default). With `cancelIfLost` it is canceled when the robot's session ends.
   */
  sendGoal(goal: Message, options?: { timeout?: number; cancelIfLost?: boolean }): Promise<Goal>;
}

/** A goal to carry out; `signal` aborts when it is to be canceled. */
export interface ServerGoal {
  readonly id: string;
  readonly request: any;
  readonly signal: AbortSignal;
  publishFeedback(value: Message): void;
}
export type GoalHandler = (goal: ServerGoal) => Message | Promise<Message>;
export interface ActionServerOptions {
  raw?: boolean;
  /** Return false to reject a goal. */
  accept?: (request: any) => boolean;
}

/** Carries out goals with its handler. */
export interface ActionServer extends Interface {}

export interface InterfaceOptions {
  /** Exchange serialized ROS messages (CDR) as bytes instead of objects. */
  raw?: boolean;
  /** Encoding of images: PNG or JPEG bytes, or objects (`json`). */
  format?: string;
  qos?: Qos;
}
/** Options of a topic of the robot. */
export interface TopicOptions extends InterfaceOptions {
  delivery?: Delivery;
  /** Exchange images and clouds as packets: objects with `codec`, `number`, `key` and `data`, and others of docs/protocol.md. */
  codec?: string;
}
export interface PublisherOptions extends TopicOptions {
  /**
   * Treatment of messages that cannot be sent, because the robot is offline or the interface has no peer: drop them (the
   * default), keep the newest one, or store all (64 MiB at most) in their order until the platform has them.
   */
  offline?: "drop" | "newest" | "store";
}
export interface SubscriberOptions<T = any> extends TopicOptions {
  /** Unread messages to keep: by default 1000, of images and point clouds 10. */
  depth?: number;
  /** Function to call with each message. */
  callback?: (message: T) => void;
}
/** `to` is the interface to connect to at once, as `endpoint/interface`. */
export type To = { to?: string };
/** Handler of a service: returns the response; an error that it throws is sent to the caller. */
export type Handler = (request: any) => Message | Promise<Message>;

/** Handle of an environment, made by `Robot.environment`, through which one robot uses its topics and services. */
export class Environment {
  readonly robot: Robot;
  readonly tag: string;
  /** Start the environment; with `existOk` an existing one of that name is accepted. */
  create(options?: { existOk?: boolean }): Promise<void>;
  /** Stop the environment and remove everything in it. */
  destroy(): Promise<void>;
  /** Start a ROS 2 node: the executable `exe` of the package `pkg`. */
  addNode(tag: string, pkg: string, exe: string, options?: NodeOptions): Promise<void>;
  /** Stop a node. */
  removeNode(tag: string): Promise<void>;
  /** Set a parameter for nodes that are started later and running ones that declare it, or for `node` only. */
  setParameter(name: string, value: ParameterValue, options?: { node?: string }): Promise<void>;
  /** Remove a parameter. */
  deleteParameter(name: string, options?: { node?: string }): Promise<void>;
  /** Record topics on the machine of the environment, all that are not hidden unless `topics` names some. */
  addRecorder(tag: string, options?: RecorderOptions): Promise<void>;
  /** End a recorder; its recordings are kept. */
  removeRecorder(tag: string): Promise<void>;
  /** Publish on a topic of the environment. */
  publisher(topic: string, typeName: string, options?: PublisherOptions): Promise<Publisher>;
  /** Subscribe to a topic of the environment. */
  subscriber<T = any>(topic: string, typeName: string, options?: SubscriberOptions<T>): Promise<Subscriber<T>>;
  /** Return a client of a service that a node of the environment offers. */
  serviceClient(service: string, typeName: string, options?: { raw?: boolean }): Promise<ServiceClient>;
  /** Offer a service to the nodes of the environment. */
  serviceProvider(service: string, typeName: string, handler: Handler, options?: { raw?: boolean }):
    Promise<ServiceProvider>;
  /** Return a client of an action that a node of the environment offers. */
  actionClient(action: string, typeName: string, options?: { raw?: boolean }): Promise<ActionClient>;
  /** Offer an action to the nodes of the environment. */
  actionServer(action: string, typeName: string, handler: GoalHandler, options?: ActionServerOptions):
    Promise<ActionServer>;
}

export interface RecorderOptions {
  /** Topics to record, also before they exist. */
  topics?: string[];
  /** Bytes of a file after which the next one begins. */
  maxSize?: number;
  /** Seconds of a file after which the next one begins. */
  maxDuration?: number;
  /** Keep a recorder of this tag that is the same, and replace one that is not. */
  existOk?: boolean;
}

/** Service of the catalogue that a robot uses; made by `Robot.service`. Asked for again after a lost session. */
export class Service {
  /** `user/name`, or the name alone of a service that comes with RCE. */
  readonly name: string;
  readonly tag: string;
  /** The instance may serve other robots too, also those of other users. */
  readonly shared: boolean;
  /** The robot's interfaces by the names in the declaration of the service. */
  readonly interfaces: Map<string, Publisher | Subscriber | ServiceClient | ActionClient>;
  /** The publisher for a topic that the service takes; throws NotFound. */
  publisher(name: string): Publisher;
  /** The subscriber of a topic that the service gives; throws NotFound. */
  subscriber(name: string): Subscriber;
  /** The client of a ROS service; throws NotFound. */
  serviceClient(name: string): ServiceClient;
  /** The client of a ROS action; throws NotFound. */
  actionClient(name: string): ActionClient;
  /** Use the service no longer: its interfaces are removed; reads and calls that wait end at once. */
  leave(): Promise<void>;
}

export interface NodeOptions {
  /** Command line arguments; `$(find PKG)` and `$(env VAR)` are substituted. */
  args?: string;
  /** ROS name of the node in place of the one in its code. */
  name?: string;
  /** ROS namespace of the node. */
  namespace?: string;
  /** Keep a node of this tag that was started in the same way, and replace one that was not. */
  existOk?: boolean;
  /** When to start it again after it ended by itself; without it, after a failure, if it ran for 5 s. */
  restart?: "on-failure" | "always" | "no";
  /** Launch file of the package, in place of `exe` (""); `args` are then `NAME:=VALUE`. */
  launch?: string;
}

/** `[list, item]` with the names of the protocol, such as `["addNodes", {containerTag: …}]` and `["CC", {…}]`. */
export type Command = [
  "CC" | "DC" | "addNodes" | "removeNodes" | "addInterfaces" | "removeInterfaces" | "setParam" | "deleteParam"
    | "addRecorders" | "removeRecorders" | "useServices" | "leaveServices" | "connect" | "disconnect",
  Record<string, unknown>,
];

export interface RobotOptions {
  user: string;
  /** robotID. One that begins with `@` is a guest: what it makes is removed with it. */
  robot: string;
  /** User whose guest the robot is; `user` by default. */
  owner?: string;
  /** API key. Give either this or a password. */
  key?: string;
  /** Password in clear; its SHA-256 is sent, which browsers compute only on pages from https or localhost. */
  password?: string;
  /** Timeout of each command, 60 by default. */
  timeout?: number;
  /** WebSocket class, for Node before version 22. */
  WebSocket?: typeof WebSocket;
}

/**
 * Robot that is connected to the platform whose entry is at `url`; entries of several Masters are separated by commas.
 *
 * It stays connected until it is closed: when the socket breaks it reconnects, takes over its interfaces and
 * connections or declares them again, and repeats the commands that have no answer yet. Commands resolve when they have
 * been executed, and reject with the platform's error, with TimedOut, or with Unavailable before `open` and after
 * `close`; while the robot is offline they wait. If the platform refuses the robot on a reconnection, everything
 * rejects with that error.
 */
export class Robot {
  constructor(url: string, options: RobotOptions);
  /** The robotID. */
  readonly name: string;
  readonly isGuest: boolean;
  /** True while the robot is online. */
  readonly connected: boolean;
  /** Protocol features that the server granted; empty while offline. */
  readonly features: Set<string>;
  /**
   * Connect. Rejects with Unauthorized, Forbidden, Unavailable, InvalidRequest, or AlreadyExists (name in use), and may
   * be called again after a failure.
   */
  open(): Promise<void>;
  /** Send the queued messages and leave. Environments stay until they are destroyed. It cannot be opened again. */
  close(): Promise<void>;
  /** A new stream of the events from now on. It ends with its `end`, and when a `for await` loop over it is left. */
  events(): Stream<Event>;
  /** A handle of an environment, which may exist already; nothing is sent. */
  environment(tag: string, options?: EnvironmentOptions): Environment;

  /**
   * Use a service of the platform's catalogue: it is started if needed, and connected to this robot. `tag` begins the
   * names of the robot's interfaces, and names the environment if the service is not shared; by default the service's.
   */
  service(name: string, options?: { tag?: string; raw?: boolean }): Promise<Service>;
  /** Use a service no longer; see `Service.leave`. */
  leaveService(service: Service): Promise<void>;
  /** Start an environment; with `existOk` an existing one of that name is accepted. */
  createEnvironment(tag: string, options?: EnvironmentOptions, how?: { existOk?: boolean }): Promise<void>;
  /** Stop an environment and remove everything in it. */
  destroyEnvironment(tag: string): Promise<void>;
  /** Start a ROS 2 node: the executable `exe` of the package `pkg`. */
  addNode(environment: string, tag: string, pkg: string, exe: string, options?: NodeOptions): Promise<void>;
  /** Stop a node. */
  removeNode(environment: string, tag: string): Promise<void>;
  /** Set a parameter for nodes that are started later and running ones that declare it, or for `node` only. */
  setParameter(environment: string, name: string, value: ParameterValue, options?: { node?: string }): Promise<void>;
  /** Remove a parameter. */
  deleteParameter(environment: string, name: string, options?: { node?: string }): Promise<void>;
  /** Record topics of an environment on its machine, all that are not hidden unless `topics` names some. */
  addRecorder(environment: string, tag: string, options?: RecorderOptions): Promise<void>;
  /** End a recorder; its recordings are kept. */
  removeRecorder(environment: string, tag: string): Promise<void>;
  /** Add an interface to an environment or a robot. */
  addInterface(endpoint: string, tag: string, interfaceType: InterfaceType, typeName: string,
    options?: { addr?: string; qos?: Qos; format?: string; delivery?: Delivery; codec?: string }): Promise<void>;
  /** Remove an interface and its connections. */
  removeInterface(endpoint: string, tag: string): Promise<void>;
  /** Connect two interfaces, each `endpoint/interface`, in either order. */
  connect(a: string, b: string): Promise<void>;
  /** Remove the connection between two interfaces. */
  disconnect(a: string, b: string): Promise<void>;
  /**
   * Execute several commands in their order without waiting in between. A failed one does not stop the others; then
   * rejects with the first error, whose `item` (`commands[2]`) names the command.
   */
  configure(...commands: Command[]): Promise<void>;

  /** Add an interface through which the robot sends messages. */
  publisher(tag: string, typeName: string, options?: PublisherOptions & To): Promise<Publisher>;
  /** Add an interface through which the robot receives messages. */
  subscriber<T = any>(tag: string, typeName: string, options?: SubscriberOptions<T> & To): Promise<Subscriber<T>>;
  /** Add an interface through which the robot calls a service. */
  serviceClient(tag: string, typeName: string, options?: { raw?: boolean } & To): Promise<ServiceClient>;
  /** Add an interface through which the robot offers a service. */
  serviceProvider(tag: string, typeName: string, handler: Handler, options?: { raw?: boolean } & To):
    Promise<ServiceProvider>;
  /** Add an interface through which the robot sends goals to an action server. */
  actionClient(tag: string, typeName: string, options?: { raw?: boolean } & To): Promise<ActionClient>;
  /** Add an interface through which the robot carries out goals. */
  actionServer(tag: string, typeName: string, handler: GoalHandler, options?: ActionServerOptions & To):
    Promise<ActionServer>;
}

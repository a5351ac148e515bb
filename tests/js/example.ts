// Typical code of users of TypeScript, compiled by test_typescript.py. A line after @ts-expect-error must be an error.

import {
  Environment, Event, InvalidRequest, Message, NotFound, Publisher, RceError, Robot, ServiceClient, Stream, Subscriber,
} from "../../rce/js/rce.js";

interface Text { data: string }

async function echo(robot: Robot): Promise<string> {
  const brain: Environment = robot.environment("brain", { memory: 2 ** 30, env: { LEVEL: "3" }, restart: "no" });
  await brain.create({ existOk: true });
  await brain.addNode("echo", "rce_demo", "echo.py", { args: "--x 1", namespace: "a" });
  await brain.setParameter("gains", [1, 2.5, 3n]);
  const heard: Subscriber<Text> = await brain.subscriber<Text>("/heard", "std_msgs/String", { depth: 5 });
  const said: Publisher = await brain.publisher("/say", "std_msgs/String", { qos: { reliability: "reliable" } });
  await said.waitConnected(10);
  await said.publish({ data: "hello" });
  if (!said.offer({ data: "again" }, 1)) console.log(said.dropped);
  for await (const message of heard) return message.data;
  return (await heard.get(3)).data;
}

async function serve(robot: Robot): Promise<void> {
  const add: ServiceClient = await robot.serviceClient("add", "rce/Add", { to: "brain/add" });
  const answer = await add.call({ a: 1, b: 2 }, 5);
  console.log(answer.sum);
  await robot.serviceProvider("look", "std_srvs/Trigger", async (request): Promise<Message> => ({ success: !!request }));
  const picture = await robot.subscriber<Uint8Array>("camera", "sensor_msgs/Image", { format: "jpeg", to: "brain/camera" });
  const bytes: number = (await picture.get()).byteLength;
  await robot.configure(
    ["CC", { containerTag: "two", containerData: { size: 1 } }],
    ["connect", { tagA: `${robot.name}/camera`, tagB: "two/camera" }],
  );
  console.log(bytes);
}

async function watch(events: Stream<Event>): Promise<void> {
  for await (const event of events) {
    if (event.topic === "node") console.log(event.nodeTag, event.status, event.lines?.length ?? 0);
    else if (event.topic === "error") console.log(event.error.code, event.error.field);
  }
}

export async function main(): Promise<void> {
  const robot = new Robot("https://localhost:9000/", { user: "ann", robot: "tablet", key: "rce_0" });
  try {
    await robot.open();
    await Promise.all([watch(robot.events()), serve(robot), echo(robot)]);
  } catch (error) {
    if (error instanceof NotFound) console.log(error.item);
    else if (error instanceof InvalidRequest || error instanceof RceError) console.log(error.fields);
    else throw error;
  } finally {
    await robot.close();
  }
}

export async function wrong(robot: Robot): Promise<void> {
  // @ts-expect-error: user is required
  new Robot("https://localhost:9000/", { robot: "tablet", key: "rce_0" });
  // @ts-expect-error: unknown option
  await robot.createEnvironment("brain", { memmory: 5 });
  // @ts-expect-error: unknown kind of interface
  await robot.addInterface("brain", "x", "Publisher", "std_msgs/String");
  // @ts-expect-error: the callback must accept the type of the messages
  await robot.subscriber<Text>("x", "std_msgs/String", { callback: (message: number) => console.log(message) });
  // @ts-expect-error: unknown command
  await robot.configure(["createContainer", {}]);
  // @ts-expect-error: read-only
  robot.connected = true;
}

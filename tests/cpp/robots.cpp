#include "check.hpp"

namespace contract {
namespace {

rce::Command interface(const rce::Client& robot, const std::string& tag, const std::string& kind) {
  return {"addInterfaces", {{"endpointTag", robot.robotID()}, {"interfaceTag", tag}, {"interfaceType", kind}, {"className", STRING}}};
}

void failedCommandsRaise(World& world) {
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  a.publisher("out", STRING);
  b.subscriber("in", POSE);
  throws<rce::NotFound>([&] { a.addConnection(a.robotID() + "/out", b.robotID() + "/nothing").get(); });
  throws<rce::NotConnectable>([&] { a.addConnection(a.robotID(), "out", b.robotID(), "in").get(); });
  const auto error = throws<rce::AlreadyExists>([&] {
    a.configure({interface(a, "other", rce::CONVERTER_SUBSCRIBER), interface(a, "out", rce::CONVERTER_SUBSCRIBER)}).get();
  });
  equal(error.item(), std::string("commands[1]"));
  a.removeInterface(a.robotID(), "other").get();
  throws<rce::NotFound>([&] { a.removeInterface(a.robotID(), "other").get(); });
}

void interfaceThatCannotBeConnectedIsRemoved(World& world) {
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  throws<rce::NotFound>([&] { a.publisher("out", STRING, rce::to(b.robotID() + "/in")); });
  auto subscriber = b.subscriber("in", STRING);
  auto publisher = a.publisher("out", STRING, rce::to(b.robotID() + "/in"));
  publisher->publish(text("x"));
  equal(subscriber->get(WAIT), text("x"));
}

void nameIsFreeAfterClose(World& world) {
  for (int count = 0; count < 3; ++count) {
    rce::Client& a = world.robot("a");
    a.publisher("out", STRING);
    a.disconnect();
  }
}

void nameInUseIsRejected(World& world) {
  world.robot("a");
  rce::Options options = world.options("a");
  options.nameWait = rce::Seconds(0);
  throws<rce::AlreadyExists>([&] { world.make(options).connect(world.url()).get(); });
}

void restartedRobotWaitsForItsName(World& world) {
  rce::Client& first = world.robot("a");
  rce::Client& second = world.make("a");
  auto opening = second.connect(world.url());
  first.disconnect();
  opening.get();
  demand(second.connected(), "the second robot is connected");
}

void configureExecutesCommandsInOrder(World& world) {
  rce::Client& a = world.robot("a");
  const std::string out = a.robotID() + "/out", in = a.robotID() + "/in";
  a.configure({interface(a, "out", rce::CONVERTER_SUBSCRIBER), interface(a, "in", rce::CONVERTER_PUBLISHER),
               {"connect", {{"tagA", out}, {"tagB", in}}}}).get();
  throws<rce::AlreadyExists>([&] { a.addConnection(in, out).get(); });
}

void refusedRobotsGetTheReason(World& world) {
  rce::Options wrong = world.options("b");
  wrong.password = "wrong";
  throws<rce::Unauthorized>([&] { world.make(wrong).connect(world.url()).get(); });
  throws<rce::InvalidRequest>([&] { world.robot("c-d"); }, "robotID");
  rce::Options both = world.options("e");
  both.key = "rce_x";
  throws<rce::InvalidRequest>([&] { world.make(both); }, "either a password or an API key");
  throws<rce::Unavailable>([&] { world.make("f").connect("http://127.0.0.1:1/").get(); }, "cannot reach");
}

void environmentIsCreatedUsedAndDestroyed(World& world) {
  rce::Client& a = world.robot("a");
  auto events = a.events();
  auto land = a.environment(world.name("land"), {{"size", 1}});
  land.create();
  throws<rce::AlreadyExists>([&] { land.create(); });
  land.create(true);
  throws<rce::AlreadyExists>([&] { a.environment(a.robotID()).create(true); });
  land.addParameter("rate", 10).get();
  land.removeParameter("rate").get();
  throws<rce::NotFound>([&] { land.removeParameter("rate").get(); });
  land.addNode("echo", "rce_demo", "echo.py").get();
  auto heard = land.subscriber("/heard", STRING);
  auto say = land.publisher("/say", STRING);
  const auto echo = [&](const Value& message) {
    Value answer;
    for (int tries = 0; answer != message && tries < 120; ++tries) {  // until the node is running
      say->publish(message, WAIT);
      try {
        answer = heard->get(rce::Seconds(0.5));
      } catch (const rce::TimedOut&) {
      }
    }
    equal(answer, message);
  };
  echo(text("hello"));
  equal(event(*events, "environment")["containerTag"], Value(land.tag()));
  rce::ClientAccess::endSession(a);
  equal(event(*events, "reconnected"), Value{{"resumed", false}});
  echo(text("again"));
  land.removeNode("echo").get();
  land.destroy().get();
}

}  // namespace

Cases robots() {
  return {{"failed commands raise", failedCommandsRaise},
          {"interface that cannot be connected is removed", interfaceThatCannotBeConnectedIsRemoved},
          {"name is free after close", nameIsFreeAfterClose},
          {"name in use is rejected", nameInUseIsRejected},
          {"restarted robot waits for its name", restartedRobotWaitsForItsName},
          {"configure executes commands in order", configureExecutesCommandsInOrder},
          {"refused robots get the reason", refusedRobotsGetTheReason},
          {"environment is created used and destroyed", environmentIsCreatedUsedAndDestroyed}};
}

}  // namespace contract

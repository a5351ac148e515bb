#include <set>

#include "check.hpp"

namespace contract {
namespace {

void resumedSessionKeepsInterfacesAndConnections(World& world) {
  Pair pair(world);
  auto back = pair.b.subscriber("back", STRING);
  auto answer = pair.a.publisher("answer", STRING, rce::to(pair.b.robotID() + "/back"));
  for (rce::Client* robot : {&pair.a, &pair.b}) {
    auto events = robot->events();
    rce::ClientAccess::breakSocket(*robot);
    event(*events, "disconnected");
    equal(event(*events, "reconnected"), Value{{"resumed", true}});
    pair.publisher->publish(text(robot->robotID()));
    answer->publish(text(robot->robotID()));
    equal(pair.subscriber->get(WAIT), text(robot->robotID()));
    equal(back->get(WAIT), text(robot->robotID()));
  }
}

void newSessionRestoresInterfacesAndConnections(World& world) {
  Pair pair(world);
  pair.b.provider("serve", SET_BOOL, [](const Value&, Value& response) {
    response["success"] = true;
    return true;
  });
  auto call = pair.a.service("call", SET_BOOL, rce::to(pair.b.robotID() + "/serve"));
  pair.a.publisher("gone", STRING, rce::to(pair.b.robotID() + "/in"))->close();
  auto events = pair.a.events();
  rce::ClientAccess::endSession(pair.a);
  event(*events, "disconnected");
  equal(event(*events, "reconnected"), Value{{"resumed", false}});
  pair.publisher->publish(text("again"));
  equal(pair.subscriber->get(WAIT), text("again"));
  demand(call->call({{"data", true}}).get()["success"], "the service answers");
  throws<rce::NotFound>([&] { pair.a.removeInterface(pair.a.robotID(), "gone").get(); });
}

void connectionIsBackWhenTheOtherRobotIs(World& world) {
  Pair pair(world);
  auto events = pair.a.events();
  pair.b.disconnect();
  equal(event(*events, "connection")["state"], Value("waiting"));
  auto subscriber = world.robot("b").subscriber("in", STRING);
  equal(event(*events, "connection")["state"], Value("restored"));
  pair.publisher->publish(text("again"));
  equal(subscriber->get(WAIT), text("again"));
}

void newSessionConnectsWhenTheOtherRobotIsBack(World& world) {
  Pair pair(world);
  pair.b.disconnect();
  auto events = pair.a.events();
  rce::ClientAccess::endSession(pair.a);
  while (event(*events, "error")["code"] != "not_found") {
  }
  auto subscriber = world.robot("b").subscriber("in", STRING);
  pair.publisher->publish(text("again"), WAIT);
  equal(subscriber->get(WAIT), text("again"));
}

void resumedSessionConnectsWhenTheOtherRobotIsBack(World& world) {
  Pair pair(world);
  pair.b.disconnect();
  auto events = pair.a.events();
  rce::ClientAccess::endSession(pair.a);
  while (event(*events, "error")["code"] != "not_found") {
  }
  rce::ClientAccess::breakSocket(pair.a);
  equal(event(*events, "reconnected"), Value{{"resumed", true}});
  auto subscriber = world.robot("b").subscriber("in", STRING);
  pair.publisher->publish(text("again"), WAIT);
  equal(subscriber->get(WAIT), text("again"));
}

void connectionToARemovedInterfaceIsGone(World& world) {
  Pair pair(world);
  auto events = pair.a.events();
  pair.subscriber->close();
  equal(event(*events, "connection")["state"], Value("gone"));
}

void commandsIssuedWhileOfflineAreExecuted(World& world) {
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  auto subscriber = b.subscriber("in", STRING);
  rce::ClientAccess::breakSocket(a);
  auto publisher = a.publisher("out", STRING, rce::to(b.robotID() + "/in"));
  publisher->publish(text("x"));
  equal(subscriber->get(WAIT), text("x"));
}

void noMessageIsDeliveredTwiceAcrossReconnections(World& world) {
  rce::InterfaceOptions options;
  options.depth = 10'000;
  Pair pair(world, STRING, options);
  int number = 0;
  for (int count = 0; count < 3; ++count) {
    auto events = pair.a.events();
    std::atomic<bool> isBack{false};
    std::thread watcher([&] {
      event(*events, "reconnected");
      isBack = true;
    });
    rce::ClientAccess::breakSocket(pair.a);
    while (!isBack) pair.publisher->publish(text(std::to_string(number++)), WAIT);
    watcher.join();
  }
  pair.publisher->publish(text(std::to_string(number)));
  std::vector<int> received;
  while (received.empty() || received.back() != number) {
    received.push_back(std::stoi(pair.subscriber->get(WAIT)["data"].get<std::string>()));
  }
  const std::set<int> once(received.begin(), received.end());
  equal(received, std::vector<int>(once.begin(), once.end()));
}

void closeFlushesQueuedMessagesAndEndsReaders(World& world) {
  rce::InterfaceOptions options;
  options.depth = 100;
  Pair pair(world, STRING, options);
  auto own = pair.a.subscriber("own", STRING);
  for (int count = 0; count < 20; ++count) pair.publisher->publish(text(std::string(100'000, 'x')));
  pair.a.disconnect();
  demand(!own->next(WAIT), "the subscriber ends");
  for (int count = 0; count < 20; ++count) pair.subscriber->get(WAIT);
  throws<rce::Unavailable>([&] { pair.a.addConnection("x/y", "y/z").get(); });
}

}  // namespace

Cases sessions() {
  return {{"resumed session keeps interfaces and connections", resumedSessionKeepsInterfacesAndConnections},
          {"new session restores interfaces and connections", newSessionRestoresInterfacesAndConnections},
          {"connection is back when the other robot is", connectionIsBackWhenTheOtherRobotIs},
          {"new session connects when the other robot is back", newSessionConnectsWhenTheOtherRobotIsBack},
          {"resumed session connects when the other robot is back", resumedSessionConnectsWhenTheOtherRobotIsBack},
          {"connection to a removed interface is gone", connectionToARemovedInterfaceIsGone},
          {"commands issued while offline are executed", commandsIssuedWhileOfflineAreExecuted},
          {"no message is delivered twice across reconnections", noMessageIsDeliveredTwiceAcrossReconnections},
          {"close flushes queued messages and ends readers", closeFlushesQueuedMessagesAndEndsReaders}};
}

}  // namespace contract

#include "check.hpp"

namespace contract {
namespace {

const Value OPEN{{"success", true}, {"message", "ok"}};

bool setBool(const Value& request, Value& response) {
  if (!request["data"]) throw std::runtime_error("the gripper is stuck");
  response = OPEN;
  return true;
}

void serviceResponsesAndErrors(World& world) {
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  b.provider("gripper", SET_BOOL, setBool);
  auto gripper = a.service("gripper", SET_BOOL, rce::to(b.robotID() + "/gripper"));
  std::vector<std::future<Value>> answers;
  for (int count = 0; count < 10; ++count) answers.push_back(gripper->call({{"data", true}}));
  for (auto& answer : answers) equal(answer.get(), OPEN);
  throws<rce::Error>([&] { gripper->call({{"data", false}}).get(); }, "the gripper is stuck");
  Signal& called = world.signal();
  gripper->call({{"data", true}}, [&](const Value& response) {
    equal(response, OPEN);
    equal(gripper->call({{"data", true}}).get(), OPEN);  // a callback may call the client, and wait
    called.set();
  });
  called.wait();
}

void plainFunctionAsHandlerAndTimeoutOfSlowService(World& world) {
  Signal& never = world.signal();
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  const Release release{never};
  b.provider("quick", SET_BOOL, &setBool);
  b.provider("slow", SET_BOOL, [&](const Value&, Value&) {
    never.wait();
    return false;
  });
  auto quick = a.service("quick", SET_BOOL, rce::to(b.robotID() + "/quick"));
  equal(quick->call({{"data", true}}).get(), OPEN);
  auto slow = a.service("slow", SET_BOOL, rce::to(b.robotID() + "/slow"));
  throws<rce::TimedOut>([&] { slow->call({{"data", true}}, rce::Seconds(0.05)).get(); }, "slow");
}

void serviceCallRaisesUnavailableWhenSocketBreaks(World& world) {
  Signal &called = world.signal(), &never = world.signal();
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  const Release release{never};
  b.provider("serve", SET_BOOL, [&](const Value&, Value&) {
    called.set();
    never.wait();
    return true;
  });
  auto client = a.service("call", SET_BOOL, rce::to(b.robotID() + "/serve"));
  auto call = client->call({{"data", true}}, WAIT);
  called.wait();
  auto events = a.events();
  rce::ClientAccess::breakSocket(a);
  throws<rce::Unavailable>([&] { call.get(); }, "not known");
  event(*events, "disconnected");
  equal(event(*events, "reconnected"), Value{{"resumed", true}});
}

void goalsEndAsTheirServerSays(World& world) {
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  b.actionServer("work", FIBONACCI, [](rce::GoalHandle& goal) -> Value {
    const int order = goal.request()["order"];
    if (order > 9) throw std::runtime_error("too many");
    if (order == 0) goal.waitCanceled();
    goal.publishFeedback({{"sequence", {1}}});
    return {{"sequence", {order}}};
  }, [](const Value& goal) { return goal["order"] >= 0; });
  auto client = a.actionClient("ask", FIBONACCI, rce::to(b.robotID() + "/work"));
  const auto send = [&](int order) { return client->sendGoal({{"order", order}}).get(); };
  auto goal = send(3);
  equal(*goal->feedback(WAIT), Value{{"sequence", {1}}});
  demand(!goal->feedback(WAIT), "the feedback ends");
  equal(goal->result(WAIT).status, std::string("succeeded"));
  equal(goal->result(WAIT).value, Value{{"sequence", {3}}});
  throws<rce::Forbidden>([&] { send(-1); }, "rejected");
  auto canceled = send(0);
  canceled->cancel(WAIT).get();
  equal(canceled->result(WAIT).status, std::string("canceled"));
  throws<rce::NotFound>([&] { canceled->cancel(WAIT).get(); }, "has ended");
  throws<rce::Error>([&] { send(10)->result(WAIT); }, "too many");
  auto kept = send(0);
  auto events = a.events();
  rce::ClientAccess::breakSocket(a);
  event(*events, "reconnected");
  client->waitConnected(WAIT);
  kept->cancel(WAIT).get();
  equal(kept->result(WAIT).status, std::string("canceled"));
}

}  // namespace

Cases services() {
  return {{"service responses and errors", serviceResponsesAndErrors},
          {"plain function as handler and timeout of slow service", plainFunctionAsHandlerAndTimeoutOfSlowService},
          {"service call raises unavailable when socket breaks", serviceCallRaisesUnavailableWhenSocketBreaks},
          {"goals end as their server says", goalsEndAsTheirServerSays}};
}

}  // namespace contract

#include <cmath>
#include <limits>

#include "check.hpp"

namespace contract {
namespace {

void messageIsDelivered(World& world) {
  Pair pair(world, POSE);
  const Value pose{{"x", 1.5}, {"y", -2.0}, {"theta", 0.5}};
  pair.publisher->publish(pose);
  equal(pair.subscriber->get(WAIT), pose);
  demand(pair.subscriber->connected(), "the subscriber is connected");
}

void valuesArriveUnchanged(World& world) {
  Pair pair(world, POSE);
  const double infinity = std::numeric_limits<double>::infinity();
  pair.publisher->publish({{"x", std::nan("")}, {"y", infinity}, {"theta", -infinity}});
  const Value pose = pair.subscriber->get(WAIT);
  demand(std::isnan(pose["x"].get<double>()), "x is not a number");
  equal(pose["y"], Value(infinity));
  equal(pose["theta"], Value(-infinity));
  auto numbers = pair.b.subscriber("numbers", INT64);
  auto number = pair.a.publisher("number", INT64, rce::to(pair.b.robotID() + "/numbers"));
  for (const std::int64_t each : {std::int64_t{-42}, std::int64_t{9007199254740993}}) {
    number->publish({{"data", each}});
    equal(numbers->get(WAIT)["data"].get<std::int64_t>(), each);
  }
  auto words = pair.b.subscriber("words", STRING);
  auto word = pair.a.publisher("word", STRING, rce::to(pair.b.robotID() + "/words"));
  word->publish(text("NaN"));
  equal(words->get(WAIT), text("NaN"));
}

void callbackGetsEachMessageOnceInOrder(World& world) {
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  std::vector<std::string> received;
  Signal& done = world.signal();
  rce::InterfaceOptions options;
  options.depth = 100;
  b.subscriber("in", STRING, [&](const Value& message) {
    const std::string data = message["data"];
    received.push_back(data);
    if (data == "50") throw std::runtime_error("the next message must be delivered all the same");
    if (data == "99") done.set();  // last: the locals of the test may end then
  }, options);
  auto events = b.events();
  auto publisher = a.publisher("out", STRING, rce::to(b.robotID() + "/in"));
  std::vector<std::string> sent;
  for (int number = 0; number < 100; ++number) {
    sent.push_back(std::to_string(number));
    publisher->publish(text(sent.back()));
  }
  done.wait();
  equal(received, sent);
  demand(event(*events, "error")["message"].get<std::string>().find("all the same") != std::string::npos, "an event");
}

void rawBytesOfAnySizeArriveUnchanged(World& world) {
  rce::InterfaceOptions raw;
  raw.raw = true;
  Pair pair(world, STRING, raw);
  for (const std::size_t size : {std::size_t{1}, std::size_t{1000}, rce::detail::PART, 3 * rce::detail::PART + 1}) {
    rce::Bytes bytes(size);
    for (std::size_t index = 0; index < size; ++index) bytes[index] = static_cast<std::uint8_t>(index * 7919 >> 3);
    pair.publisher->publish(bytes);
    pair.publisher->publish(std::make_shared<const rce::Bytes>(bytes));
    for (const char* how : {" copied", " shared"}) {
      const Value got = pair.subscriber->get(WAIT);
      demand(static_cast<const rce::Bytes&>(got.get_binary()) == bytes, std::to_string(size) + how + " bytes are unchanged");
    }
  }
  throws<rce::InvalidRequest>([&] { pair.publisher->publish(std::shared_ptr<const rce::Bytes>()); }, "pointer is null");
}

void smallMessageOvertakesLargeOne(World& world) {
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  std::mutex mutex;
  std::vector<std::string> order;
  Signal& done = world.signal();
  const auto note = [&](const std::string& word) {
    std::size_t count = 0;
    {
      const std::lock_guard<std::mutex> lock(mutex);
      order.push_back(word);
      count = order.size();
    }
    if (count == 2) done.set();
  };
  rce::InterfaceOptions raw;
  raw.raw = true;
  b.subscriber("images", STRING, [&](const Value&) { note("large"); }, raw);
  b.subscriber("velocities", POSE, [&](const Value&) { note("small"); });
  raw.to = b.robotID() + "/images";
  auto images = a.publisher("images", STRING, raw);
  auto velocities = a.publisher("velocities", POSE, rce::to(b.robotID() + "/velocities"));
  images->publish(rce::Bytes(20'000'000));
  velocities->publish({{"x", 1.0}});
  done.wait();
  equal(order, std::vector<std::string>{"small", "large"});
}

void withoutPeerPublishRaisesAndOfferDrops(World& world) {
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  auto publisher = a.publisher("out", STRING);
  throws<rce::NotConnected>([&] { publisher->publish(text("x"), rce::Seconds(0.01)); }, "/out");
  demand(!publisher->offer(text("x")), "offer returns false");
  equal(publisher->dropped(), std::size_t{1});
  auto subscriber = b.subscriber("in", STRING, rce::to(a.robotID() + "/out"));
  publisher->waitConnected(WAIT);
  demand(publisher->offer(text("y")), "offer returns true");
  equal(subscriber->get(WAIT), text("y"));
  auto events = a.events();
  subscriber->close();
  while (publisher->connected()) event(*events, "connection");
}

void publisherThatDoesNotWaitKeepsWhatItShould(World& world) {
  rce::Client &a = world.robot("a"), &b = world.robot("b");
  using Kept = std::vector<std::string>;
  const std::vector<std::pair<rce::Offline, Kept>> choices{
      {rce::Offline::drop, {}}, {rce::Offline::newest, {"2"}}, {rce::Offline::store, {"0", "1", "2"}}};
  for (const auto& [offline, kept] : choices) {
    const std::string number = std::to_string(kept.size());
    rce::InterfaceOptions options;
    options.offline = offline;
    auto publisher = a.publisher("out" + number, STRING, options);
    for (int each = 0; each < 3; ++each) publisher->publishNow(text(std::to_string(each)));
    equal(publisher->dropped(), 3 - kept.size());
    auto subscriber = b.subscriber("in" + number, STRING, rce::to(a.robotID() + "/out" + number));
    publisher->waitConnected(WAIT);
    publisher->publish(text("last"));
    for (const std::string& each : kept) equal(subscriber->get(WAIT), text(each));
    equal(subscriber->get(WAIT), text("last"));
    for (int each = 0; each < 20; ++each) {
      publisher->publishNow(text(std::to_string(each)));
      equal(subscriber->get(WAIT), text(std::to_string(each)));
    }
  }
}

}  // namespace

Cases topics() {
  return {{"message is delivered", messageIsDelivered},
          {"values arrive unchanged", valuesArriveUnchanged},
          {"callback gets each message once in order", callbackGetsEachMessageOnceInOrder},
          {"raw bytes of any size arrive unchanged", rawBytesOfAnySizeArriveUnchanged},
          {"small message overtakes large one", smallMessageOvertakesLargeOne},
          {"without peer publish raises and offer drops", withoutPeerPublishRaisesAndOfferDrops},
          {"publisher that does not wait keeps what it should", publisherThatDoesNotWaitKeepsWhatItShould}};
}

}  // namespace contract

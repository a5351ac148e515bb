// Measures round trips through nodes that send messages back on TOPIC_back, and between two interfaces of the robot, for
// `rce bench rtt --routes cpp`.
//
//   rce_round_trips URL USER ROBOT ENVIRONMENT NAMESPACE
//
// The password is in RCE_PASSWORD, or an API key in RCE_KEY. Each line of the input, `FORM SIZE [PATIENCE]`, is answered
// with the seconds of one round trip of SIZE bytes, or with `late`. FORM is `json` or `forwarder`, with `r2r_` in front
// for one without nodes.

#include <chrono>
#include <cstdlib>
#include <iostream>
#include <map>
#include <rce/client.hpp>
#include <rce/memory.hpp>
#include <sstream>

namespace {

const char* variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

/** Interfaces by which messages go out and come back. */
struct Way {
  rce::PublisherPtr out;
  rce::SubscriberPtr back;
  bool raw = false;
};

/** CDR of a std_msgs/UInt8MultiArray with `size` zero bytes. */
std::shared_ptr<const rce::Bytes> cdr(std::size_t size) {
  rce::Bytes bytes(16 + size, 0);
  bytes[1] = 1;
  for (std::size_t place = 0; place < 4; ++place) bytes[12 + place] = static_cast<std::uint8_t>(size >> (8 * place));
  return std::make_shared<const rce::Bytes>(std::move(bytes));
}

/** Discard answers that came too late for their round trip. */
void discard(rce::Subscriber& back) {
  try {
    while (true) back.get(rce::Seconds(0));
  } catch (const rce::TimedOut&) {
  }
}

/** Seconds of one round trip; throws TimedOut. */
double roundTrip(const Way& way, const std::string& text, const std::shared_ptr<const rce::Bytes>& bytes, double patience) {
  discard(*way.back);
  const auto start = std::chrono::steady_clock::now();
  if (way.raw) {
    way.out->publish(bytes);
  } else {
    way.out->publish(rce::Value{{"data", text}});
  }
  way.back->get(rce::Seconds(patience));
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace

int main(int count, char** words) {
  if (count != 6) {
    std::cerr << "usage: rce_round_trips URL USER ROBOT ENVIRONMENT NAMESPACE\n";
    return 2;
  }
  rce::keepLargeBlocks();
  try {
    rce::Options options;
    options.userID = words[2];
    options.robotID = words[3];
    options.password = variable("RCE_PASSWORD");
    options.key = variable("RCE_KEY");
    rce::Client robot(options);
    robot.connect(words[1]).get();
    auto place = robot.environment(words[4]);
    const std::string base = words[5];
    rce::InterfaceOptions forwarder, toForwarder = rce::to(options.robotID + "/forwarder_back");
    forwarder.raw = toForwarder.raw = true;
    const std::string array = "std_msgs/UInt8MultiArray", string = "std_msgs/String";
    std::map<std::string, Way> ways;
    ways["json"] = {place.publisher(base + "/json", string), place.subscriber(base + "/json_back", string)};
    ways["forwarder"] = {place.publisher(base + "/forwarder", array, forwarder),
                         place.subscriber(base + "/forwarder_back", array, forwarder), true};
    const auto jsonBack = robot.subscriber("json_back", string);  // before the publishers, which connect to them
    const auto cdrBack = robot.subscriber("forwarder_back", array, forwarder);
    ways["r2r_json"] = {robot.publisher("json", string, rce::to(options.robotID + "/json_back")), jsonBack};
    ways["r2r_forwarder"] = {robot.publisher("forwarder", array, toForwarder), cdrBack, true};
    std::size_t made = 0;
    std::string text;
    std::shared_ptr<const rce::Bytes> bytes = cdr(0);
    for (std::string line; std::getline(std::cin, line);) {
      std::istringstream request(line);
      std::string form;
      std::size_t size = 0;
      double patience = 30;
      request >> form >> size >> patience;
      const auto way = ways.find(form);
      if (way == ways.end()) {
        std::cerr << "unknown form: " << form << '\n';
        return 2;
      }
      if (size != made) text.assign(size, 'x'), bytes = cdr(size), made = size;
      try {
        std::cout << roundTrip(way->second, text, bytes, patience) << std::endl;
      } catch (const rce::TimedOut&) {
        std::cout << "late" << std::endl;
      }
    }
  } catch (const rce::Error& error) {
    std::cerr << error.code() << ": " << error.what() << '\n';
    return 1;
  }
}

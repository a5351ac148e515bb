// Helpers of the contract: robots of a case, checks, and what breaks sockets.
#pragma once

#include <condition_variable>
#include <functional>
#include <iostream>
#include <list>
#include <mutex>
#include <rce/client.hpp>
#include <sstream>

#include "core.hpp"  // of the library's sources

namespace rce {

/** Access of tests to the inside of a client. */
struct ClientAccess {
  static void breakSocket(Client& client) {
    client.core_->post([core = client.core_] {
      if (auto* connection = core->session().connection()) connection->abort();
    });
  }

  static void endSession(Client& client) {
    client.core_->post([core = client.core_] { core->session().forgetToken(); });
    breakSocket(client);
  }
};

}  // namespace rce

namespace contract {

using rce::Value;

constexpr rce::Seconds WAIT{60};  // a limit that only ends a test that hangs
inline const std::string STRING = "std_msgs/String", POSE = "geometry_msgs/Pose2D", INT64 = "std_msgs/Int64",
                         SET_BOOL = "std_srvs/SetBool", FIBONACCI = "example_interfaces/Fibonacci";

/** Something that happens once. */
class Signal {
 public:
  void set() {
    const std::lock_guard<std::mutex> lock(mutex_);
    isSet_ = true;
    changed_.notify_all();
  }

  void wait() {
    std::unique_lock<std::mutex> lock(mutex_);
    if (!rce::waitFor(changed_, lock, WAIT, [this] { return isSet_; })) throw std::runtime_error("nothing happened");
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  bool isSet_ = false;
};

/** The robots of one case. */
class World {
 public:
  World(std::string url, std::string tag, std::string caFile = "")
      : url_(std::move(url)), tag_(std::move(tag)), caFile_(std::move(caFile)) {}

  std::string name(const std::string& letter) const { return tag_ + letter; }

  rce::Options options(const std::string& letter) const {
    rce::Options options;
    options.userID = options.password = "testUser";
    options.robotID = name(letter);
    options.caFile = caFile_;
    return options;
  }

  /** A robot that is not connected yet. */
  rce::Client& make(const std::string& letter) { return make(options(letter)); }

  rce::Client& make(const rce::Options& options) {
    robots_.emplace_back(options);
    return robots_.back();
  }

  rce::Client& robot(const std::string& letter) {
    rce::Client& made = make(letter);
    made.connect(url_).get();
    return made;
  }

  /** A signal that lives longer than the callbacks of the robots. */
  Signal& signal() { return signals_.emplace_back(); }

  const std::string& url() const { return url_; }

 private:
  std::string url_, tag_, caFile_;
  std::list<Signal> signals_;
  std::list<rce::Client> robots_;  // destroyed before the signals: their callbacks have ended then
};

struct Pair {
  explicit Pair(World& world, const std::string& type = STRING, rce::InterfaceOptions options = {})
      : a(world.robot("a")), b(world.robot("b")), subscriber(b.subscriber("in", type, options)) {
    options.to = b.robotID() + "/in";
    publisher = a.publisher("out", type, options);
  }

  rce::Client& a;
  rce::Client& b;
  rce::SubscriberPtr subscriber;
  rce::PublisherPtr publisher;
};

/** Ends a blocking callback at the end of a case, also of one that failed. */
struct Release {
  Signal& signal;
  ~Release() { signal.set(); }
};

template <class Got, class Wanted>
void equal(const Got& got, const Wanted& wanted) {
  if (got == wanted) return;
  std::ostringstream text;
  text << "got " << Value(got).dump().substr(0, 300) << ", not " << Value(wanted).dump().substr(0, 300);
  throw std::runtime_error(text.str());
}

inline void demand(bool holds, const std::string& what) {
  if (!holds) throw std::runtime_error("not true: " + what);
}

/** Return the error of this class that the call throws. */
template <class Kind>
Kind throws(const std::function<void()>& call, const std::string& words = "") {
  try {
    call();
  } catch (const Kind& error) {
    demand(std::string(error.what()).find(words) != std::string::npos, std::string(error.what()) + " has: " + words);
    return error;
  }
  throw std::runtime_error("nothing was thrown");
}

/** The next event of a topic. */
inline Value event(rce::Stream<rce::Event>& events, const std::string& topic) {
  for (;;) {
    rce::Event each = events.get(WAIT);
    if (each.topic == topic) return each.data;
  }
}

inline Value text(const std::string& data) { return {{"data", data}}; }

using Case = std::function<void(World&)>;
using Cases = std::vector<std::pair<std::string, Case>>;

Cases topics();
Cases services();
Cases sessions();
Cases robots();

}  // namespace contract

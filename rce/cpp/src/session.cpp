#include "session.hpp"

#include <algorithm>

#include "entry.hpp"

namespace rce::detail {
namespace {

const std::string FEATURES = "ack,events,parts,resume";
const std::string COMMANDS = " commands";  // their source in the outbox; a tag cannot contain a space
constexpr Seconds MIN_DELAY{0.1}, MAX_DELAY{10};  // between attempts to connect; the first is immediate
constexpr Seconds CLOSE_LIMIT{7};                // to write what is queued and to close

bool isOneOf(const std::string& word, std::initializer_list<const char*> words) {
  return std::find(words.begin(), words.end(), word) != words.end();
}

std::string frameOf(const Command& command, int id) {
  if (isOneOf(command.list, {"CC", "DC"})) return encode({{"type", command.list}, {"data", command.item}, {"id", id}});
  const bool isConnection = isOneOf(command.list, {"connect", "disconnect"});
  return encode({{"type", isConnection ? "CX" : "CN"}, {"data", {{command.list, Value::array({command.item})}}}, {"id", id}});
}

/** True if the answer to a repeated command means that an earlier attempt was executed. */
bool isDone(const Command& command, const ErrorInfo& error) {
  const bool removes = isOneOf(command.list, {"DC", "removeNodes", "removeInterfaces", "deleteParam", "removeRecorders", "leaveServices", "disconnect"});
  return error.code == (removes ? "not_found" : "already_exists");
}

}  // namespace

Session::Session(Transport& transport, const Options& options, Listener& listener)
    : transport_(transport), options_(options), listener_(listener) {}

void Session::open(const std::string& url, Done done) {
  if (state_ != State::fresh) return done(ErrorInfo{"invalid_request", "this robot has been connected before: make a new one"});
  state_ = State::opening;
  url_ = url;
  opened_ = std::move(done);
  delay_ = Seconds(0);
  openUntil_ = std::chrono::steady_clock::now() + std::chrono::duration_cast<std::chrono::steady_clock::duration>(options_.nameWait);
  dial();
}

void Session::close(Done done) {
  if (state_ == State::fresh) state_ = State::ended;
  if (state_ == State::ended || !connection_) {
    end(std::nullopt);
    return done(std::nullopt);
  }
  closed_ = std::move(done);
  closing_ = connection_;
  closing_->close();
  closeLimit_ = after(CLOSE_LIMIT, [this] { closing_->abort(); });
  end(std::nullopt);
}

void Session::execute(Command command, Done done, Acknowledged acknowledged) {
  if (state_ != State::open) return done(error_);
  submit(std::move(command), std::move(done), false, std::move(acknowledged));
}

std::shared_ptr<boost::asio::steady_timer> Session::after(Seconds seconds, std::function<void()> call) {
  auto timer = std::make_shared<boost::asio::steady_timer>(transport_.io);
  timer->expires_after(std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::min(seconds, forever)));
  timer->async_wait([held = std::weak_ptr(timer), call = std::move(call)](const boost::system::error_code& canceled) {
    if (!canceled && !held.expired()) call();
  });
  return timer;
}

// --- commands

int Session::submit(Command command, Done done, bool restores, Acknowledged acknowledged) {
  const int id = ++lastId_;
  const std::string list = command.list;
  Request added{std::move(command), std::move(done), restores, std::move(acknowledged)};
  Request& request = requests_.emplace(id, std::move(added)).first->second;
  request.timer = after(options_.timeout, [this, id, list] {
    finish(id, ErrorInfo{"timed_out", list + " was not answered within " + std::to_string(options_.timeout.count()) + " s"});
  });
  send(id);
  return id;
}

void Session::send(int id) {
  const auto found = requests_.find(id);
  if (!connection_ || found == requests_.end()) return;
  try {
    std::string text = frameOf(found->second.command, id);
    found->second.attempts += 1;
    connection_->put(COMMANDS, {{std::move(text)}});
  } catch (const Error& error) {
    finish(id, error.info());
  }
}

void Session::finish(int id, const std::optional<ErrorInfo>& error) {
  const auto found = requests_.find(id);
  if (found == requests_.end()) return;
  const Done done = std::move(found->second.done);
  requests_.erase(found);
  done(error);
}

// --- connections

/** Connect to the endpoint that may still hold the session, else to the one that the entry assigns. */
void Session::dial() {
  asksEntry_ = token_.empty();
  if (asksEntry_) locateEndpoint();
  else dialEndpoint(endpoint_);
}

void Session::dialEndpoint(const std::string& endpoint) {
  Query query{{"userID", options_.userID}, {"robotID", options_.robotID}, {"features", FEATURES}};
  if (!options_.owner.empty()) query.emplace_back("owner", options_.owner);
  if (!options_.key.empty()) query.emplace_back("key", options_.key);
  else query.emplace_back("password", sha256(options_.password));
  if (!token_.empty()) query.emplace_back("resume", token_);
  try {
    attempt_ = Connection::open(transport_, endpoint, query, *this);
  } catch (const Error& error) {
    failed({"unavailable", "the entry assigned an endpoint that is none: " + error.info().message});
  }
}

void Session::locateEndpoint() {
  asksEntry_ = true;
  const auto ifWanted = [this](auto call) {
    if (state_ != State::ended) call();
  };
  try {
    locate(transport_, url_, options_.userID,
           [=](const std::string& endpoint) { ifWanted([&] { dialEndpoint(endpoint); }); },
           [=](const ErrorInfo& error) { ifWanted([&] { failed(error); }); });
  } catch (const Error& error) {
    failed(error.info());
  }
}

/** An attempt failed: try another way, later, or not again. */
void Session::failed(const ErrorInfo& error) {
  attempt_.reset();
  if (!asksEntry_ && isOneOf(error.code, {"unavailable", "invalid_request"})) return locateEndpoint();
  if (state_ == State::open) {
    if (isOneOf(error.code, {"unauthorized", "forbidden", "not_found"})) return end(error);
    return retry();
  }
  if (error.code == "already_exists" && std::chrono::steady_clock::now() < openUntil_) {
    delay_ = std::min(delay_, Seconds(0.5));
    return retry();
  }
  state_ = State::fresh;
  std::exchange(opened_, nullptr)(error);
}

void Session::retry() {
  // Jitter, because many robots must not reconnect at the same moment.
  retry_ = after(delay_ * std::uniform_real_distribution<double>(0.5, 1.0)(random_), [this] { dial(); });
  delay_ = std::min(std::max(2 * delay_, MIN_DELAY), MAX_DELAY);
}

void Session::connectionOpened(Connection& connection, Value session) {
  if (&connection != attempt_.get()) return;
  connection_ = std::move(attempt_);
  endpoint_ = connection_->endpoint();
  token_ = textOf(session, "token");
  delay_ = Seconds(0);
  ++epoch_;
  if (state_ == State::opening) {
    state_ = State::open;
    return std::exchange(opened_, nullptr)(std::nullopt);
  }
  const bool isResumed = session.value("resumed", false);
  listener_.reconnected(isResumed, session.value("interfaces", Value::object()));
  restore(isResumed);
}

void Session::connectionRefused(Connection& connection, ErrorInfo error) {
  if (&connection == attempt_.get()) failed(error);
}

void Session::connectionClosed(Connection& connection, std::string reason) {
  if (&connection == closing_.get()) {
    closing_.reset();
    closeLimit_.reset();
    return std::exchange(closed_, nullptr)(std::nullopt);
  }
  if (&connection != connection_.get()) return;
  const auto held = std::move(connection_);
  connection_.reset();
  for (auto request = requests_.begin(); request != requests_.end();) {
    // The next connection determines anew which declarations are missing.
    request = request->second.restores ? requests_.erase(request) : std::next(request);
  }
  listener_.disconnected(std::move(reason));
  retry();
}

/** Declare again what the platform no longer has, then repeat the pending commands, all in their order. */
void Session::restore(bool isResumed) {
  std::vector<int> pending;
  for (const auto& [id, request] : requests_) pending.push_back(id);
  std::vector<Command> missing;
  for (Command& command : listener_.declarations()) {
    if (!isResumed || isUnrestored(command)) missing.push_back(std::move(command));
  }
  unrestored_ = missing;
  for (const Command& command : missing) redeclare(command, MIN_DELAY, false);
  for (const int id : pending) send(id);
}

bool Session::isUnrestored(const Command& command) const {
  return std::find(unrestored_.begin(), unrestored_.end(), command) != unrestored_.end();
}

/** Send a declaration; repeat it while what it needs, as the peer, is not back yet. */
void Session::redeclare(const Command& command, Seconds delay, bool isReported) {
  submit(command, [=, epoch = epoch_](const std::optional<ErrorInfo>& error) {
    if (epoch != epoch_ || state_ != State::open) return;
    if (error && !isReported && error->code != "unavailable") listener_.errorReceived(*error);
    if (!error || !isOneOf(error->code, {"unavailable", "not_found", "unknown_type", "timed_out"})) {
      unrestored_.erase(std::remove(unrestored_.begin(), unrestored_.end(), command), unrestored_.end());
      return;
    }
    auto timer = std::make_shared<std::shared_ptr<boost::asio::steady_timer>>();
    *timer = after(delay, [=] {
      timer->reset();
      const auto wanted = listener_.declarations();
      if (epoch != epoch_ || !connection_ || std::find(wanted.begin(), wanted.end(), command) == wanted.end()) return;
      redeclare(command, std::min(2 * delay, MAX_DELAY), true);
    });
  }, true);
}

// --- frames

void Session::messageReceived(Connection& connection, Value data, BlobsById blobs) {
  if (&connection == connection_.get()) listener_.messageReceived(std::move(data), std::move(blobs));
}

void Session::statusReceived(Connection& connection, Value frame) {
  if (&connection != connection_.get()) return;
  const std::string topic = textOf(frame["data"], "topic");
  if (topic == "ack") acknowledge(frame);
  else if (topic != "session") listener_.statusReceived(std::move(frame["data"]));
}

void Session::acknowledge(const Value& frame) {
  const int id = frame.value("id", 0);
  const auto found = requests_.find(id);
  if (found == requests_.end()) return;
  if (found->second.acknowledged) found->second.acknowledged(frame["data"]);
  finish(id, std::nullopt);
}

void Session::failureReceived(Connection& connection, Value frame) {
  if (&connection != connection_.get()) return;
  const ErrorInfo error = errorOf(frame);
  const auto request = requests_.find(frame.contains("id") && frame["id"].is_number_integer() ? frame["id"].get<int>() : 0);
  if (request == requests_.end()) return listener_.errorReceived(error);
  const bool isRepeated = request->second.restores || request->second.attempts > 1;
  if (isRepeated && isDone(request->second.command, error)) finish(request->first, std::nullopt);
  else finish(request->first, error);
}

void Session::frameInvalid(Connection& connection, ErrorInfo error) {
  if (&connection == connection_.get()) listener_.errorReceived(std::move(error));
}

void Session::end(const std::optional<ErrorInfo>& error) {
  if (state_ == State::ended) return;
  state_ = State::ended;
  error_ = error ? *error : ErrorInfo{"unavailable", "the robot has been closed"};
  if (attempt_) std::exchange(attempt_, nullptr)->forget();
  retry_.reset();
  connection_.reset();
  while (!requests_.empty()) finish(requests_.begin()->first, error_);
  if (opened_) std::exchange(opened_, nullptr)(error_);
  listener_.ended(error);
}

}  // namespace rce::detail

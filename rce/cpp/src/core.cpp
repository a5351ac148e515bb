#include "core.hpp"

#include <boost/asio/post.hpp>
#include <set>

namespace rce::detail {
namespace {

constexpr std::size_t EVENT_BACKLOG = 1000;  // unread events that one reader may have
constexpr std::size_t EARLY = 1000;          // newest messages and statuses that are kept for the interfaces of a service

/** Key of a connection, whatever the order of its ends. */
std::string pairOf(const Value& item) {
  std::string a = textOf(item, "tagA"), b = textOf(item, "tagB");
  return a < b ? a + ' ' + b : b + ' ' + a;
}

std::string placeOf(const Value& item) { return textOf(item, "endpointTag") + '/' + textOf(item, "interfaceTag"); }

bool beginsWith(const std::string& text, const std::string& start) { return text.compare(0, start.size(), start) == 0; }

}  // namespace

Core::Core(Options options)
    : options_(std::move(options)), session_(transport_, options_, *this), work_(transport_.io.get_executor()) {
  if (options_.password.empty() == options_.key.empty()) {
    raise({"invalid_request", "give either a password or an API key", "", "password"});
  }
  boost::system::error_code ignored;  // a system without certificates: then only caFile is trusted
  transport_.tls.set_default_verify_paths(ignored);
  if (!options_.caFile.empty()) {
    boost::system::error_code error;
    transport_.tls.load_verify_file(options_.caFile, error);
    if (error) raise({"invalid_request", "cannot read certificates from " + options_.caFile + ": " + error.message(), "", "caFile"});
  }
  loop_ = std::thread([this] { transport_.io.run(); });
}

Core::~Core() { stop(); }

void Core::post(std::function<void()> call) {
  boost::asio::post(transport_.io, std::move(call));
  if (isStopped_) drain();
}

/** Run what was posted after the event loop had ended. */
void Core::drain() {
  const std::lock_guard<std::recursive_mutex> lock(drainMutex_);
  transport_.io.restart();
  transport_.io.poll();
}

void Core::spawn(std::function<void()> call) {
  const std::lock_guard<std::mutex> lock(workersMutex_);
  for (auto worker = workers_.begin(); worker != workers_.end();) {
    if (!*worker->isDone) {
      ++worker;
      continue;
    }
    if (worker->thread.get_id() == std::this_thread::get_id()) worker->thread.detach();
    else worker->thread.join();
    worker = workers_.erase(worker);
  }
  auto isDone = std::make_shared<std::atomic<bool>>(false);
  workers_.push_back({std::thread([isDone, call = std::move(call)] {
                        call();
                        *isDone = true;
                      }),
                      isDone});
}

void Core::guarded(const std::function<void()>& callback) noexcept {
  try {
    callback();
  } catch (const Error& error) {
    publish(error.info());
  } catch (const std::exception& error) {
    publish(ErrorInfo{"internal", std::string("a callback failed: ") + error.what()});
  } catch (...) {
    publish(ErrorInfo{"internal", "a callback failed with an exception that is not a std::exception"});
  }
}

void Core::stop() {
  const std::unique_lock<std::mutex> lock(stopMutex_, std::try_to_lock);
  if (!lock || !loop_.joinable()) return;  // a callback may disconnect while another thread does, too
  std::promise<void> closed;
  post([&] { session_.close([&](const auto&) { closed.set_value(); }); });
  closed.get_future().wait();
  std::list<Worker> workers;
  {
    const std::lock_guard<std::mutex> guard(workersMutex_);
    workers.swap(workers_);
  }
  for (Worker& worker : workers) {
    if (worker.thread.get_id() == std::this_thread::get_id()) worker.thread.detach();  // a callback that disconnects
    else worker.thread.join();
  }
  work_.reset();
  transport_.io.stop();
  loop_.join();
  isStopped_ = true;
  post([this] { interfaces_.clear(); });
}

std::shared_ptr<Stream<Event>> Core::events() {
  auto stream = std::make_shared<Stream<Event>>(EVENT_BACKLOG);
  const std::lock_guard<std::mutex> lock(readersMutex_);
  if (readersEnded_) stream->end(readersError_);
  else readers_.push_back(stream);
  return stream;
}

void Core::publish(Event event) {
  const std::lock_guard<std::mutex> lock(readersMutex_);
  for (auto reader = readers_.begin(); reader != readers_.end();) {
    const auto stream = reader->lock();
    if (stream) stream->put(event);
    reader = stream ? std::next(reader) : readers_.erase(reader);
  }
}

void Core::publish(const ErrorInfo& error) {
  publish(Event{"error", {{"code", error.code}, {"message", error.message}, {"item", error.item},
                          {"field", error.field}, {"fields", error.fields}}});
}

void Core::execute(Command command, Done done, Acknowledged acknowledged) {
  session_.execute(
      command,
      [this, command, done = std::move(done)](const std::optional<ErrorInfo>& error) {
        if (!error) record(command);
        else if (error->code == "already_exists") recordExisting(command);
        done(error);
      },
      std::move(acknowledged));
}

void Core::add(std::shared_ptr<Interface> added, bool isOpen) {
  if (isOpen) added->setStatus(true);
  interfaces_[added->tag()] = std::move(added);
}

void Core::remove(const std::string& tag) {
  const auto found = interfaces_.find(tag);
  if (found == interfaces_.end()) return;
  const auto held = std::move(found->second);
  interfaces_.erase(found);
  held->end(std::nullopt);
}

/** Keep what came for an interface that does not exist yet, if such ones are expected. */
void Core::keep(const std::string& tag, std::function<void()> again) {
  for (auto& [prefix, kept] : early_) {
    if (!beginsWith(tag, prefix)) continue;
    kept.push_back(std::move(again));
    if (kept.size() > EARLY) kept.pop_front();
    return;
  }
}

/** Deliver what came early, to those of the interfaces that exist now. */
void Core::adopt(const std::string& prefix) {
  const auto found = early_.find(prefix);
  if (found == early_.end()) return;
  const auto held = std::move(found->second);
  early_.erase(found);
  for (const auto& again : held) again();
}

// --- called by the session

void Core::messageReceived(Value data, BlobsById blobs) {
  const std::string tag = textOf(data, "iTag");
  const auto found = interfaces_.find(tag);
  if (found != interfaces_.end()) return found->second->receive(std::move(data), std::move(blobs));
  keep(tag, [this, data = std::move(data), blobs = std::move(blobs)] { messageReceived(data, blobs); });
}

void Core::statusReceived(Value data) {
  const std::string topic = textOf(data, "topic");
  if (topic == "iu") {
    const std::string tag = textOf(data, "iTag");
    const auto found = interfaces_.find(tag);
    if (found != interfaces_.end()) found->second->setStatus(data.value("status", false));
    else keep(tag, [this, data] { statusReceived(data); });
    return;
  }
  if (topic == "connection" && textOf(data, "state") == "gone") connectionsDeclared_.erase(pairOf(data));
  publish(Event{topic, std::move(data)});
}

void Core::errorReceived(ErrorInfo error) {
  const std::string id = textOf(error.fields, "msgID");
  if (!id.empty()) {
    for (const auto& [tag, each] : interfaces_) {
      if (each->failCall(error, id)) return;
    }
  }
  publish(error);
}

void Core::disconnected(std::string reason) {
  isOnline_ = false;
  for (const auto& [tag, each] : interfaces_) each->setDisconnected();
  publish(Event{"disconnected", {{"reason", std::move(reason)}}});
}

void Core::reconnected(bool isResumed, const Value& statuses) {
  isOnline_ = true;
  for (const auto& [tag, each] : interfaces_) each->setStatus(statuses.is_object() && statuses.value(tag, false));
  publish(Event{"reconnected", {{"resumed", isResumed}}});
}

std::vector<Command> Core::declarations() const {
  std::vector<Command> commands;
  for (const auto& [tag, command] : interfacesDeclared_) commands.push_back(command);
  std::set<std::string> connected;
  for (const auto& [tags, command] : connectionsDeclared_) {
    connected.insert({textOf(command.item, "tagA"), textOf(command.item, "tagB")});
  }
  for (const auto& [tag, command] : counterpartsDeclared_) {
    if (connected.count(tag) != 0) commands.push_back(command);
  }
  for (const auto& [tags, command] : connectionsDeclared_) commands.push_back(command);
  for (const auto& [tag, command] : servicesDeclared_) commands.push_back(command);
  return commands;
}

void Core::ended(const std::optional<ErrorInfo>& error) {
  isOnline_ = false;
  for (const auto& [tag, each] : interfaces_) each->end(error);
  const std::lock_guard<std::mutex> lock(readersMutex_);
  readersEnded_ = true;
  readersError_ = error;
  for (const auto& reader : readers_) {
    if (const auto stream = reader.lock()) stream->end(error);
  }
}

/** Whether an interface ends with the robot: its own and, for a guest, its own in environments. */
bool Core::isOwn(const Value& item) const {
  const std::string& robot = options_.robotID;
  const bool isGuests = robot[0] == '@' && beginsWith(textOf(item, "interfaceTag"), robot + '.');
  return isGuests || textOf(item, "endpointTag") == robot;
}

/** Record an interface of an environment that could not be added because it exists. */
void Core::recordExisting(const Command& command) {
  if (command.list == "addInterfaces" && !isOwn(command.item)) record(command);
}

/**
 * Record what belongs to this robot after a command was executed, so that a new session can restore it: its own
 * interfaces, those that it is connected with in environments, and its connections.
 */
void Core::record(const Command& command) {
  const auto& [list, item] = command;
  const std::string& robot = options_.robotID;
  if (list == "addInterfaces") {
    (isOwn(item) ? interfacesDeclared_ : counterpartsDeclared_).insert_or_assign(placeOf(item), command);
  } else if (list == "removeInterfaces") {
    forget([place = placeOf(item)](const std::string& tag) { return tag == place; });
  } else if (list == "DC") {
    forget([start = textOf(item, "containerTag") + '/'](const std::string& tag) { return beginsWith(tag, start); });
  } else if (list == "useServices") {
    servicesDeclared_.insert_or_assign(textOf(item, "containerTag"), command);
  } else if (list == "leaveServices") {
    servicesDeclared_.erase(textOf(item, "containerTag"));
  } else if (list == "disconnect") {
    connectionsDeclared_.erase(pairOf(item));
  } else if (list == "connect" && (beginsWith(textOf(item, "tagA"), robot + '/') || beginsWith(textOf(item, "tagB"), robot + '/'))) {
    connectionsDeclared_.insert_or_assign(pairOf(item), command);
  }
}

void Core::forget(const std::function<bool(const std::string&)>& isRemoved) {
  for (auto* of : {&interfacesDeclared_, &counterpartsDeclared_}) {
    for (auto each = of->begin(); each != of->end();) {
      each = isRemoved(each->first) ? of->erase(each) : std::next(each);
    }
  }
  for (auto each = connectionsDeclared_.begin(); each != connectionsDeclared_.end();) {
    const Value& item = each->second.item;
    const bool isGone = isRemoved(textOf(item, "tagA")) || isRemoved(textOf(item, "tagB"));
    each = isGone ? connectionsDeclared_.erase(each) : std::next(each);
  }
}

}  // namespace rce::detail

#include "rce/interfaces.hpp"

#include <algorithm>

#include "core.hpp"

namespace rce {
namespace {

const std::string TOPIC_ID = "nil";       // msgID of topic messages, as the original's clients send it
constexpr std::size_t HIGH_WATER = 8;     // queued messages at which `publish` waits
constexpr std::size_t MOST_STORED = 10'000, MOST_STORED_BYTES = 64u << 20;
constexpr std::size_t SHALLOW = 10, DEEP = 1000;

std::size_t depthOf(const std::string& type) {
  const auto slash = type.rfind('/');
  const std::string name = type.substr(slash == std::string::npos ? 0 : slash + 1);
  const bool isLarge = type.compare(0, 12, "sensor_msgs/") == 0 &&
                       (name == "Image" || name == "CompressedImage" || name == "PointCloud" || name == "PointCloud2");
  return isLarge ? SHALLOW : DEEP;
}

}  // namespace

InterfaceOptions to(std::string interface) {
  InterfaceOptions options;
  options.to = std::move(interface);
  return options;
}

// --- Interface

Interface::Interface(std::shared_ptr<detail::Core> core, std::string tag, std::string type)
    : core_(std::move(core)), tag_(std::move(tag)), type_(std::move(type)) {}

bool Interface::connected() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return open_;
}

bool Interface::wasConnected() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return met_;
}

void Interface::waitConnected(Seconds timeout) {
  std::unique_lock<std::mutex> lock(mutex_);
  const bool isSettled = waitFor(changed_, lock, timeout, [this] { return open_ || ended_; });
  if (ended_) raise(*ended_);
  if (!isSettled) raise(notConnected(timeout));
}

void Interface::close() {
  std::promise<void> done;
  core_->post([&] {
    core_->remove(tag_);
    core_->execute({"removeInterfaces", {{"endpointTag", core_->options().robotID}, {"interfaceTag", tag_}}},
                   [&](const std::optional<ErrorInfo>& error) {
                     if (error) done.set_exception(exceptionOf(*error));
                     else done.set_value();
                   });
  });
  done.get_future().get();
}

void Interface::receive(Value, std::map<std::string, Bytes>) {}

void Interface::setStatus(bool isOpen) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    open_ = isOpen && !ended_;
    met_ = met_ || open_;
    changed_.notify_all();
  }
  statusChanged();
}

void Interface::setDisconnected() {
  setStatus(false);
  disconnected();
}

void Interface::end(const std::optional<ErrorInfo>& error) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (ended_) return;
    open_ = false;
    ended_ = error ? *error : ErrorInfo{"unavailable", name() + " has been closed"};
    changed_.notify_all();
  }
  ended(error);
}

Value Interface::header(const std::string& msgId) const { return {{"iTag", tag_}, {"type", type_}, {"msgID", msgId}}; }

void Interface::send(detail::Encoded message) {
  core_->post([this, self = core_, message = std::move(message)]() mutable {
    if (auto* connection = self->session().connection()) connection->put(tag_, {std::move(message)});
  });
}

std::string Interface::name() const { return core_->options().robotID + '/' + tag_; }

ErrorInfo Interface::notConnected(Seconds timeout) const {
  return {"not_connected", name() + " has had no peer for " + std::to_string(timeout.count()) + " s: connect it to an existing interface"};
}

// --- Publisher

Publisher::Publisher(std::shared_ptr<detail::Core> core, std::string tag, std::string type, Offline offline)
    : Interface(std::move(core), std::move(tag), std::move(type)), offline_(offline) {}

void Publisher::publish(Value message, Seconds timeout) { publishEncoded(encoded(std::move(message)), timeout); }

void Publisher::publish(Bytes message, Seconds timeout) {
  publish(std::make_shared<const Bytes>(std::move(message)), timeout);
}

void Publisher::publish(std::shared_ptr<const Bytes> message, Seconds timeout) {
  if (!message) raise({"invalid_request", "a message for " + name() + " has no bytes: its pointer is null"});
  publishEncoded(detail::encodeMessage(header(TOPIC_ID), std::move(message)), timeout);
}

void Publisher::publishEncoded(detail::Encoded content, Seconds timeout) {
  for (;;) {
    waitConnected(timeout);
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return (queued_ < HIGH_WATER && backlog_.empty()) || !open_; });
    if (!open_) continue;
    ++queued_;
    break;
  }
  put(std::move(content), detail::KEEP_ALL);
}

bool Publisher::offer(Value message, std::size_t keep) {
  detail::Encoded content = encoded(std::move(message));
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!open_) {
      ++dropped_;
      return false;
    }
    ++queued_;
  }
  put(std::move(content), std::max<std::size_t>(keep, 1));
  return true;
}

void Publisher::publishNow(Value message) {
  auto content = std::make_shared<const detail::Encoded>(encoded(std::move(message)));
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (ended_) raise(*ended_);
    if (offline_ == Offline::drop && !open_) {
      ++dropped_;
      return;
    }
    const std::size_t most = offline_ == Offline::store ? MOST_STORED : 1;
    backlogBytes_ += content->size();
    backlog_.push_back(std::move(content));
    while (backlog_.size() > most || (backlogBytes_ > MOST_STORED_BYTES && backlog_.size() > 1)) {
      backlogBytes_ -= backlog_.front()->size();
      backlog_.pop_front();
      ++dropped_;
    }
  }
  core_->post([self = shared_from_this()] { self->sendNext(); });
}

std::size_t Publisher::dropped() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return dropped_;
}

detail::Encoded Publisher::encoded(Value message) const {
  return detail::encodeMessage(header(TOPIC_ID), std::move(message));
}

/** Queue a message, which `queued_` counts already. */
void Publisher::put(detail::Encoded message, std::size_t keep) {
  core_->post([self = shared_from_this(), message = std::move(message), keep]() mutable {
    auto written = self->ticket();
    auto* connection = self->core_->session().connection();
    if (!connection) return;
    detail::Outgoing outgoing{std::move(message)};
    outgoing.ticket = std::move(written);
    self->drop(connection->put(self->tag_, std::move(outgoing), keep));
  });
}

void Publisher::drop(std::size_t count) {
  const std::lock_guard<std::mutex> lock(mutex_);
  dropped_ += count;
}

/** What a message in the outbox holds: when it is released, there is room for another one. */
std::shared_ptr<const void> Publisher::ticket() {
  return {nullptr, [self = shared_from_this()](const void*) {
            const std::lock_guard<std::mutex> lock(self->mutex_);
            --self->queued_;
            self->changed_.notify_all();
          }};
}

/** Queue the first message of the backlog; the others wait here, so that at most one is lost with the socket. */
void Publisher::sendNext() {
  auto* connection = core_->session().connection();
  std::shared_ptr<const detail::Encoded> first;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (backlog_.empty() || !open_ || !connection || sending_) return;
    first = backlog_.front();
    sending_ = first.get();
  }
  detail::Outgoing outgoing{*first};
  outgoing.onStart = [self = shared_from_this(), first] {
    {
      const std::lock_guard<std::mutex> lock(self->mutex_);
      if (self->sending_ != first.get()) return;
      self->sending_ = nullptr;
      if (!self->backlog_.empty() && self->backlog_.front() == first) {
        self->backlog_.pop_front();
        self->backlogBytes_ -= first->size();
      }
      self->changed_.notify_all();
    }
    self->core_->post([self] { self->sendNext(); });
  };
  connection->put(tag_, std::move(outgoing));
}

void Publisher::statusChanged() {
  if (connected()) return sendNext();
  const std::lock_guard<std::mutex> lock(mutex_);
  if (offline_ != Offline::drop) return;
  dropped_ += backlog_.size();
  backlog_.clear();
  backlogBytes_ = 0;
}

void Publisher::disconnected() {
  const std::lock_guard<std::mutex> lock(mutex_);
  sending_ = nullptr;
}

// --- Subscriber

Subscriber::Subscriber(std::shared_ptr<detail::Core> core, std::string tag, std::string type, std::size_t depth)
    : Interface(std::move(core), std::move(tag), std::move(type)),
      messages_(std::make_shared<Stream<Value>>(depth != 0 ? depth : depthOf(type_))) {}

void Subscriber::receive(Value data, std::map<std::string, Bytes> blobs) {
  messages_->put(detail::contentOf(std::move(data), std::move(blobs)));
}

}  // namespace rce

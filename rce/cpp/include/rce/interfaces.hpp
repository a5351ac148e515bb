// Publishers and subscribers of a robot, made by the methods of Client and Environment.
#pragma once

#include <functional>
#include <map>

#include "rce/stream.hpp"

namespace rce {

namespace detail {
class Core;
struct Encoded;
}  // namespace detail

/** Treatment of messages that `Publisher::publishNow` cannot send: dropped, the newest kept, or stored in order. */
enum class Offline { drop, newest, store };

/** Options of an interface; those that do not concern its kind have no effect. */
struct InterfaceOptions {
  std::string to{};             // `endpoint/interface` to connect to
  bool raw = false;             // messages are bytes: CDR, unchanged
  std::string format{};         // of images: png, jpeg, json; of a raw interface: cdr, ros1
  Value qos{};                  // as in docs/protocol.md
  std::size_t depth = 0;        // unread messages that a subscriber keeps; 0 for 1000, or 10 of images and clouds
  Offline offline = Offline::drop;
};

/** Options of an interface that is connected to `endpoint/interface`. */
InterfaceOptions to(std::string interface);

/** Base of all interfaces of a robot. Thread-safe. */
class Interface {
 public:
  virtual ~Interface() = default;
  Interface(const Interface&) = delete;
  Interface& operator=(const Interface&) = delete;

  const std::string& tag() const noexcept { return tag_; }
  const std::string& type() const noexcept { return type_; }

  /** True while the robot is online and the interface has a peer that is online too. */
  bool connected() const;

  /** True once the interface has had a peer, which may be gone again. */
  bool wasConnected() const;

  /** Wait for a peer. Throws NotConnected after the timeout, and Unavailable when the interface was closed. */
  void waitConnected(Seconds timeout = connectTimeout);

  /** Remove the interface and its connections. */
  void close();

 protected:
  Interface(std::shared_ptr<detail::Core> core, std::string tag, std::string type);

  friend class detail::Core;
  // Called in the thread of the event loop.
  virtual void receive(Value data, std::map<std::string, Bytes> blobs);
  virtual void statusChanged() {}
  virtual void disconnected() {}
  virtual void ended(const std::optional<ErrorInfo>&) {}
  virtual bool failCall(const ErrorInfo&, const std::string&) { return false; }
  void setStatus(bool isOpen);
  void setDisconnected();
  void end(const std::optional<ErrorInfo>& error);

  /** The `data` of a DM of this interface, without its content. */
  Value header(const std::string& msgId) const;
  /** Queue a message, unless the robot is offline. */
  void send(detail::Encoded message);
  ErrorInfo notConnected(Seconds timeout) const;
  std::string name() const;

  const std::shared_ptr<detail::Core> core_;
  const std::string tag_;
  const std::string type_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;  // guarded by mutex_, like what follows
  bool open_ = false;
  bool met_ = false;  // it has had a peer
  std::optional<ErrorInfo> ended_;
};

/** Sends messages. Those that had not reached the platform when the socket broke are lost; none is sent twice. */
class Publisher : public Interface, public std::enable_shared_from_this<Publisher> {
 public:
  /** Send a message after waiting for a peer and for room in the queue. Throws as `waitConnected`, and InvalidRequest. */
  void publish(Value message, Seconds timeout = connectTimeout);

  /** Send the bytes of an image file or, with `raw`, of a serialized message. */
  void publish(Bytes message, Seconds timeout = connectTimeout);

  /** The same without a copy: the bytes must not change until they are sent. Throws InvalidRequest for a null pointer. */
  void publish(std::shared_ptr<const Bytes> message, Seconds timeout = connectTimeout);

  /** Send without waiting, so that at most `keep` messages are queued. False if there is no peer. */
  bool offer(Value message, std::size_t keep = 1);

  /** Send without waiting; `offline` of the publisher says what becomes of messages that cannot be sent now. */
  void publishNow(Value message);

  /** Number of messages that `offer` and `publishNow` dropped. */
  std::size_t dropped() const;

 private:
  friend class Client;
  struct Waiting;
  Publisher(std::shared_ptr<detail::Core> core, std::string tag, std::string type, Offline offline);

  void statusChanged() override;
  void disconnected() override;
  detail::Encoded encoded(Value message) const;
  void publishEncoded(detail::Encoded content, Seconds timeout);
  void put(detail::Encoded message, std::size_t keep);
  void sendNext();
  void drop(std::size_t count);
  std::shared_ptr<const void> ticket();

  const Offline offline_;
  std::size_t queued_ = 0;  // messages in the outbox; guarded by mutex_, like what follows
  std::size_t dropped_ = 0;
  std::deque<std::shared_ptr<const detail::Encoded>> backlog_;
  std::size_t backlogBytes_ = 0;
  const detail::Encoded* sending_ = nullptr;  // the message of the backlog that is in the outbox
};

using MsgCallback = std::function<void(const Value& message)>;

/** Receives messages, by `get`, `next` or a callback. Keeps the newest `depth` unread messages. */
class Subscriber : public Interface {
 public:
  /** The next message. Throws TimedOut, Unavailable after the end, or the error that ended the robot. */
  Value get(Seconds timeout = forever) { return messages_->get(timeout); }

  /** The next message, or nothing after the end. */
  std::optional<Value> next(Seconds timeout = forever) { return messages_->next(timeout); }

  /** Number of messages that were dropped because more than `depth` were unread. */
  std::size_t dropped() const { return messages_->dropped(); }

  /** Remove the interface, as the original named it. */
  void unsubscribe() { close(); }

 private:
  friend class Client;
  Subscriber(std::shared_ptr<detail::Core> core, std::string tag, std::string type, std::size_t depth);
  void receive(Value data, std::map<std::string, Bytes> blobs) override;
  void ended(const std::optional<ErrorInfo>& error) override { messages_->end(error); }

  const std::shared_ptr<Stream<Value>> messages_;
};

using PublisherPtr = std::shared_ptr<Publisher>;
using SubscriberPtr = std::shared_ptr<Subscriber>;

}  // namespace rce

// Actions: goals that are sent, and goals that are carried out.
#pragma once

#include <atomic>
#include <future>

#include "rce/interfaces.hpp"

namespace rce {

class ActionClient;

/** End of a goal: `succeeded`, `canceled` or `aborted`, and its result. */
struct GoalResult {
  std::string status;
  Value value;
};

/** A goal that was accepted. */
class Goal {
 public:
  const std::string& id() const noexcept { return id_; }

  /** The next feedback, or nothing after the end of the goal. Throws TimedOut. The newest 100 are kept. */
  std::optional<Value> feedback(Seconds timeout = forever) { return feedback_.next(timeout); }

  /** The end of the goal. Throws TimedOut, or the error with which the goal failed. */
  GoalResult result(Seconds timeout = forever);

  /** Ask the server to cancel the goal. The future has Forbidden if it does not, NotFound if the goal has ended. */
  std::future<void> cancel(Seconds timeout = connectTimeout);

 private:
  friend class ActionClient;
  Goal(std::shared_ptr<ActionClient> client, std::string id);

  const std::shared_ptr<ActionClient> client_;
  const std::string id_;
  Stream<Value> feedback_{100};
  Stream<GoalResult> end_{1};
  std::mutex mutex_;
  std::optional<GoalResult> result_;
};

/** Options of one goal. */
struct GoalOptions {
  Seconds timeout = connectTimeout;  // to be accepted
  bool cancelIfLost = false;         // cancel it when the robot's session ends
};

/** Sends goals to an action server. When the robot is back after its socket broke, it asks for their results. */
class ActionClient : public Interface, public std::enable_shared_from_this<ActionClient> {
 public:
  /** Send a goal. The future has it when it was accepted; or Forbidden, NotConnected, TimedOut (then it is canceled). */
  std::future<std::shared_ptr<Goal>> sendGoal(Value goal, GoalOptions options = {});

 private:
  friend class Client;
  friend class Goal;
  struct Sent;
  ActionClient(std::shared_ptr<detail::Core> core, std::string tag, std::string type);
  void receive(Value data, std::map<std::string, Bytes> blobs) override;
  void statusChanged() override;
  void disconnected() override;
  void ended(const std::optional<ErrorInfo>& error) override;
  bool failCall(const ErrorInfo& error, const std::string& id) override;
  void transmit(Sent& sent);
  void report(const std::string& id, const std::string& phase);
  void cancel(const std::string& id, Seconds timeout, std::shared_ptr<std::promise<void>> done);
  void fail(const std::string& id, const ErrorInfo& error);

  std::map<std::string, std::shared_ptr<Sent>> goals_;  // used in the thread of the event loop
  bool isStale_ = false;
};

class ActionServer;

/** A goal as the handler of an action server sees it. */
class GoalHandle {
 public:
  const std::string& id() const noexcept { return id_; }
  const Value& request() const noexcept { return request_; }

  /** True when the goal is to be canceled; what the handler returns then ends a canceled goal. */
  bool canceled() const;

  /** Wait until the goal is to be canceled; false after the timeout. */
  bool waitCanceled(Seconds timeout = forever);

  void publishFeedback(Value feedback);

 private:
  friend class ActionServer;
  GoalHandle(std::shared_ptr<ActionServer> server, std::string id, Value request);
  void cancel();

  const std::shared_ptr<ActionServer> server_;
  const std::string id_;
  const Value request_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  bool canceled_ = false;
};

/** Carries out a goal in a thread of its own and returns its result; an exception aborts the goal. */
using GoalCallback = std::function<Value(GoalHandle& goal)>;
/** Decides whether to accept a goal. */
using AcceptCallback = std::function<bool(const Value& goal)>;

/** Carries out goals. */
class ActionServer : public Interface, public std::enable_shared_from_this<ActionServer> {
 private:
  friend class Client;
  friend class GoalHandle;
  struct Request {
    std::string id;
    Value content;
  };
  ActionServer(std::shared_ptr<detail::Core> core, std::string tag, std::string type);
  void receive(Value data, std::map<std::string, Bytes> blobs) override;
  void ended(const std::optional<ErrorInfo>& error) override;
  void start(const GoalCallback& callback, const AcceptCallback& accept, Request request);
  void run(const GoalCallback& callback, GoalHandle& goal);
  void report(const std::string& id, const std::string& phase, Value more = Value::object(), Value msg = {});

  const std::shared_ptr<Stream<Request>> requests_;
  std::mutex goalsMutex_;
  std::map<std::string, std::shared_ptr<GoalHandle>> running_;
};

using GoalPtr = std::shared_ptr<Goal>;
using ActionClientPtr = std::shared_ptr<ActionClient>;
using ActionServerPtr = std::shared_ptr<ActionServer>;

}  // namespace rce

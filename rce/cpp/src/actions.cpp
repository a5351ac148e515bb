#include "rce/actions.hpp"

#include "core.hpp"

namespace rce {
namespace {

constexpr std::size_t MOST_GOALS = 1000;  // goals that wait for the decision whether to accept them

detail::Encoded phaseMessage(Value data, const std::string& phase) {
  data["phase"] = phase;
  return {detail::encode({{"type", "DM"}, {"data", std::move(data)}})};
}

}  // namespace

// --- Goal

Goal::Goal(std::shared_ptr<ActionClient> client, std::string id) : client_(std::move(client)), id_(std::move(id)) {}

GoalResult Goal::result(Seconds timeout) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!result_) result_ = end_.get(timeout);
  return *result_;
}

std::future<void> Goal::cancel(Seconds timeout) {
  auto done = std::make_shared<std::promise<void>>();
  auto future = done->get_future();
  client_->cancel(id_, timeout, std::move(done));
  return future;
}

// --- ActionClient

struct ActionClient::Sent {
  std::shared_ptr<Goal> goal;
  detail::Encoded request;
  std::promise<std::shared_ptr<Goal>> accepted{};
  std::shared_ptr<boost::asio::steady_timer> timer{};  // until it is accepted
  bool isSent = false;
  bool isAccepted = false;
  std::vector<std::shared_ptr<std::promise<void>>> canceling{};
  std::shared_ptr<boost::asio::steady_timer> cancelTimer{};

  void accept() {
    if (std::exchange(isAccepted, true)) return;
    timer.reset();
    accepted.set_value(goal);
  }

  void canceled(const std::optional<ErrorInfo>& error) {
    cancelTimer.reset();
    for (const auto& done : std::exchange(canceling, {})) {
      if (error) done->set_exception(exceptionOf(*error));
      else done->set_value();
    }
  }
};

ActionClient::ActionClient(std::shared_ptr<detail::Core> core, std::string tag, std::string type)
    : Interface(std::move(core), std::move(tag), std::move(type)) {}

std::future<GoalPtr> ActionClient::sendGoal(Value goal, GoalOptions options) {
  const std::string id = detail::freshId();
  Value data = header(id);
  data["phase"] = "goal";
  if (options.cancelIfLost) data["ifLost"] = "cancel";
  auto sent = std::make_shared<Sent>(
      Sent{GoalPtr(new Goal(shared_from_this(), id)), detail::encodeMessage(std::move(data), std::move(goal))});
  auto accepted = sent->accepted.get_future();
  core_->post([self = shared_from_this(), sent, id, timeout = options.timeout] {
    {
      const std::lock_guard<std::mutex> lock(self->mutex_);
      if (self->ended_) return sent->accepted.set_exception(exceptionOf(*self->ended_));
    }
    self->goals_[id] = sent;
    sent->timer = self->core_->session().after(timeout, [raw = self.get(), id, timeout] {
      const bool isSent = raw->goals_[id]->isSent;
      raw->fail(id, isSent ? ErrorInfo{"timed_out", "action " + raw->tag_ + " (" + raw->type_ + ") did not answer within " +
                                                        std::to_string(timeout.count()) + " s"}
                           : raw->notConnected(timeout));
      if (isSent) raw->report(id, "cancel");
    });
    if (self->connected()) self->transmit(*sent);
  });
  return accepted;
}

void ActionClient::transmit(Sent& sent) {
  auto* connection = core_->session().connection();
  if (!connection || sent.isSent) return;
  sent.isSent = true;
  connection->put(tag_, {std::move(sent.request)});
}

/** Send a message about a goal; nothing while the robot is offline. */
void ActionClient::report(const std::string& id, const std::string& phase) { send(phaseMessage(header(id), phase)); }

void ActionClient::cancel(const std::string& id, Seconds timeout, std::shared_ptr<std::promise<void>> done) {
  core_->post([self = shared_from_this(), id, timeout, done = std::move(done)] {
    const auto found = self->goals_.find(id);
    if (found == self->goals_.end()) {
      return done->set_exception(exceptionOf({"not_found", "the goal of " + self->tag_ + " has ended: it cannot be canceled"}));
    }
    Sent& sent = *found->second;
    sent.canceling.push_back(done);
    if (sent.canceling.size() > 1) return;
    sent.cancelTimer = self->core_->session().after(timeout, [raw = self.get(), id, timeout] {
      raw->goals_[id]->canceled(ErrorInfo{
          "timed_out", "action " + raw->tag_ + " did not answer within " + std::to_string(timeout.count()) + " s"});
    });
    if (self->connected()) self->report(id, "cancel");
  });
}

void ActionClient::receive(Value data, std::map<std::string, Bytes> blobs) {
  const std::string id = detail::textOf(data, "msgID"), phase = detail::textOf(data, "phase");
  const auto found = goals_.find(id);
  if (found == goals_.end()) return;
  const auto sent = found->second;
  if (phase == "accepted") {
    sent->accept();
  } else if (phase == "rejected") {
    fail(id, {"forbidden", "action " + tag_ + " (" + type_ + ") rejected the goal"});
  } else if (phase == "feedback") {
    sent->goal->feedback_.put(detail::contentOf(std::move(data), std::move(blobs)));
  } else if (phase == "cancel") {
    sent->canceled(std::nullopt);
  } else if (phase == "result") {
    const std::string status = detail::textOf(data, "status");
    Value content = detail::contentOf(std::move(data), std::move(blobs));
    goals_.erase(found);
    sent->accept();
    sent->canceled(status == "canceled" ? std::nullopt : std::optional(ErrorInfo{"unavailable", "the goal has ended"}));
    sent->goal->end_.put({status, std::move(content)});
    sent->goal->feedback_.end();
  }
}

void ActionClient::fail(const std::string& id, const ErrorInfo& error) {
  const auto found = goals_.find(id);
  if (found == goals_.end()) return;
  const auto sent = found->second;
  goals_.erase(found);
  sent->timer.reset();
  sent->canceled(error);
  if (!std::exchange(sent->isAccepted, true)) sent->accepted.set_exception(exceptionOf(error));
  sent->goal->end_.end(error);
  sent->goal->feedback_.end();
}

bool ActionClient::failCall(const ErrorInfo& error, const std::string& id) {
  const auto found = goals_.find(id);
  if (found == goals_.end()) return false;
  if (detail::textOf(error.fields, "phase") == "cancel") found->second->canceled(error);
  else fail(id, error);
  return true;
}

void ActionClient::statusChanged() {
  if (!connected()) return;
  for (const auto& [id, sent] : goals_) {
    if (!sent->isSent) transmit(*sent);
    else if (isStale_) report(id, "result");
  }
  isStale_ = false;
}

void ActionClient::disconnected() {
  isStale_ = true;
  const ErrorInfo error{"unavailable", "the socket broke: it is not known whether the goal is being canceled"};
  for (const auto& [id, sent] : goals_) sent->canceled(error);
}

void ActionClient::ended(const std::optional<ErrorInfo>& error) {
  const ErrorInfo reason = error ? *error : ErrorInfo{"unavailable", name() + " has been closed"};
  while (!goals_.empty()) fail(std::string(goals_.begin()->first), reason);
}

// --- GoalHandle

GoalHandle::GoalHandle(std::shared_ptr<ActionServer> server, std::string id, Value request)
    : server_(std::move(server)), id_(std::move(id)), request_(std::move(request)) {}

bool GoalHandle::canceled() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return canceled_;
}

bool GoalHandle::waitCanceled(Seconds timeout) {
  std::unique_lock<std::mutex> lock(mutex_);
  return waitFor(changed_, lock, timeout, [this] { return canceled_; });
}

void GoalHandle::publishFeedback(Value feedback) {
  server_->report(id_, "feedback", Value::object(), std::move(feedback));
}

void GoalHandle::cancel() {
  const std::lock_guard<std::mutex> lock(mutex_);
  canceled_ = true;
  changed_.notify_all();
}

// --- ActionServer

ActionServer::ActionServer(std::shared_ptr<detail::Core> core, std::string tag, std::string type)
    : Interface(std::move(core), std::move(tag), std::move(type)), requests_(std::make_shared<Stream<Request>>(MOST_GOALS)) {}

void ActionServer::receive(Value data, std::map<std::string, Bytes> blobs) {
  const std::string id = detail::textOf(data, "msgID"), phase = detail::textOf(data, "phase");
  if (phase == "goal") return requests_->put({id, detail::contentOf(std::move(data), std::move(blobs))});
  if (phase != "cancel") return;
  std::shared_ptr<GoalHandle> goal;
  {
    const std::lock_guard<std::mutex> lock(goalsMutex_);
    const auto found = running_.find(id);
    if (found != running_.end()) goal = found->second;
  }
  report(id, "cancel", goal ? Value::object() : Value{{"error", "the goal has ended"}});
  if (goal) goal->cancel();
}

void ActionServer::ended(const std::optional<ErrorInfo>&) {
  requests_->end();
  const std::lock_guard<std::mutex> lock(goalsMutex_);
  for (const auto& [id, goal] : running_) goal->cancel();  // so that the handlers end
}

void ActionServer::start(const GoalCallback& callback, const AcceptCallback& accept, Request request) {
  bool isAccepted = false;
  core_->guarded([&] { isAccepted = !accept || accept(request.content); });
  if (!isAccepted) return report(request.id, "rejected");
  const std::shared_ptr<GoalHandle> goal(new GoalHandle(shared_from_this(), request.id, std::move(request.content)));
  {
    const std::lock_guard<std::mutex> lock(goalsMutex_);
    running_[goal->id()] = goal;
  }
  report(goal->id(), "accepted");
  core_->spawn([self = shared_from_this(), callback, goal] { self->run(callback, *goal); });
}

void ActionServer::run(const GoalCallback& callback, GoalHandle& goal) {
  Value end, result;
  try {
    result = callback(goal);
    end["status"] = goal.canceled() ? "canceled" : "succeeded";
  } catch (const std::exception& error) {
    if (goal.canceled()) end["status"] = "canceled";
    else end = {{"status", "aborted"}, {"error", error.what()}};
  } catch (...) {
    end = {{"status", "aborted"}, {"error", "the handler failed"}};
  }
  {
    const std::lock_guard<std::mutex> lock(goalsMutex_);
    running_.erase(goal.id());
  }
  core_->guarded([&] {
    waitConnected(forever);  // the result must not get lost while the robot is offline
    report(goal.id(), "result", std::move(end), std::move(result));
  });
}

void ActionServer::report(const std::string& id, const std::string& phase, Value more, Value msg) {
  Value data = header(id);
  data.update(more);
  if (msg.is_null()) return send(phaseMessage(std::move(data), phase));
  data["phase"] = phase;
  send(detail::encodeMessage(std::move(data), std::move(msg)));
}

}  // namespace rce

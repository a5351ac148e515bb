#include "rce/services.hpp"

#include "core.hpp"

namespace rce {
namespace {

constexpr std::size_t MOST_CALLS = 1000;  // calls that wait for their turn

}  // namespace

// --- ServiceClient

struct ServiceClient::Call {
  std::string id;
  detail::Encoded request;
  std::promise<Value> response{};
  MsgCallback callback{};
  bool isSent = false;
  std::shared_ptr<boost::asio::steady_timer> timer{};
};

ServiceClient::ServiceClient(std::shared_ptr<detail::Core> core, std::string tag, std::string type, MsgCallback callback)
    : Interface(std::move(core), std::move(tag), std::move(type)), callback_(std::move(callback)),
      answers_(std::make_shared<Stream<std::function<void()>>>(MOST_CALLS)) {}

std::future<Value> ServiceClient::call(Value request, Seconds timeout) {
  const std::string id = detail::freshId();
  auto call = std::make_shared<Call>(Call{id, detail::encodeMessage(header(id), std::move(request))});
  call->callback = callback_;
  auto response = call->response.get_future();
  begin(std::move(call), timeout);
  return response;
}

void ServiceClient::call(Value request, MsgCallback callback, Seconds timeout) {
  const std::string id = detail::freshId();
  auto call = std::make_shared<Call>(Call{id, detail::encodeMessage(header(id), std::move(request))});
  call->callback = std::move(callback);
  begin(std::move(call), timeout);
}

void ServiceClient::begin(std::shared_ptr<Call> call, Seconds timeout) {
  core_->post([self = shared_from_this(), call, timeout] {
    {
      const std::lock_guard<std::mutex> lock(self->mutex_);
      if (self->ended_) return call->response.set_exception(exceptionOf(*self->ended_));
    }
    self->calls_[call->id] = call;
    call->timer = self->core_->session().after(timeout, [raw = self.get(), id = call->id, timeout] {
      raw->failCall(raw->calls_[id]->isSent
                        ? ErrorInfo{"timed_out", "service " + raw->tag_ + " (" + raw->type_ + ") did not answer within " +
                                                     std::to_string(timeout.count()) + " s"}
                        : raw->notConnected(timeout),
                    id);
    });
    if (self->connected()) self->transmit(*call);
  });
}

void ServiceClient::transmit(Call& call) {
  auto* connection = core_->session().connection();
  if (!connection || call.isSent) return;
  call.isSent = true;
  connection->put(tag_, {std::move(call.request)});
}

void ServiceClient::finish(const std::string& id, const std::function<void(Call&)>& settle) {
  const auto found = calls_.find(id);
  if (found == calls_.end()) return;  // the call has timed out
  const auto call = found->second;
  calls_.erase(found);
  call->timer.reset();
  settle(*call);
}

void ServiceClient::receive(Value data, std::map<std::string, Bytes> blobs) {
  const std::string id = detail::textOf(data, "msgID"), error = detail::textOf(data, "error");
  if (!error.empty()) {
    failCall({"error", error}, id);
    return;
  }
  Value response = detail::contentOf(std::move(data), std::move(blobs));
  finish(id, [&](Call& call) {
    if (call.callback) answers_->put([callback = call.callback, response] { callback(response); });
    call.response.set_value(std::move(response));
  });
}

bool ServiceClient::failCall(const ErrorInfo& error, const std::string& id) {
  if (calls_.count(id) == 0) return false;
  finish(id, [&](Call& call) {
    if (call.callback) core_->publish(error);
    call.response.set_exception(exceptionOf(error));
  });
  return true;
}

void ServiceClient::statusChanged() {
  if (!connected()) return;
  for (const auto& [id, call] : calls_) transmit(*call);
}

void ServiceClient::disconnected() {
  const ErrorInfo error{"unavailable", "the socket broke during the call of " + tag_ + ": it is not known whether it was executed"};
  std::vector<std::string> sent;
  for (const auto& [id, call] : calls_) {
    if (call->isSent) sent.push_back(id);
  }
  for (const std::string& id : sent) failCall(error, id);
}

void ServiceClient::ended(const std::optional<ErrorInfo>& error) {
  failAll(error ? *error : ErrorInfo{"unavailable", name() + " has been closed"});
  answers_->end();
}

void ServiceClient::failAll(const ErrorInfo& error) {
  while (!calls_.empty()) failCall(error, std::string(calls_.begin()->first));
}

// --- ServiceProvider

ServiceProvider::ServiceProvider(std::shared_ptr<detail::Core> core, std::string tag, std::string type)
    : Interface(std::move(core), std::move(tag), std::move(type)), requests_(std::make_shared<Stream<Request>>(MOST_CALLS)) {}

void ServiceProvider::receive(Value data, std::map<std::string, Bytes> blobs) {
  std::string id = detail::textOf(data, "msgID");
  requests_->put({std::move(id), detail::contentOf(std::move(data), std::move(blobs))});
}

void ServiceProvider::ended(const std::optional<ErrorInfo>&) { requests_->end(); }

void ServiceProvider::answer(const ServiceCallback& callback, const Request& request) {
  Value data = header(request.id);
  try {
    Value response = Value::object();
    if (callback(request.content, response)) return send(detail::encodeMessage(std::move(data), std::move(response)));
    data["error"] = "the service refused the request";
  } catch (const std::exception& error) {
    data["error"] = error.what();
  } catch (...) {
    data["error"] = "the service failed";
  }
  send({detail::encode({{"type", "DM"}, {"data", data}})});
}

}  // namespace rce

// Services: calls, and answers to calls.
#pragma once

#include <future>

#include "rce/interfaces.hpp"

namespace rce {

/** Fills in the response; false, or an exception, becomes an error of the caller. */
using ServiceCallback = std::function<bool(const Value& request, Value& response)>;

/** Calls a service. */
class ServiceClient : public Interface, public std::enable_shared_from_this<ServiceClient> {
 public:
  /**
   * Call the service, after waiting for a peer. The future has the response, or the service's error, TimedOut,
   * NotConnected, or Unavailable if the socket broke meanwhile: then it is not known whether the call was executed.
   */
  std::future<Value> call(Value request, Seconds timeout = connectTimeout);

  /** Call the service; the callback gets the response, and an event reports an error. */
  void call(Value request, MsgCallback callback, Seconds timeout = connectTimeout);

 private:
  friend class Client;
  struct Call;
  ServiceClient(std::shared_ptr<detail::Core> core, std::string tag, std::string type, MsgCallback callback);
  void receive(Value data, std::map<std::string, Bytes> blobs) override;
  void statusChanged() override;
  void disconnected() override;
  void ended(const std::optional<ErrorInfo>& error) override;
  bool failCall(const ErrorInfo& error, const std::string& id) override;
  void begin(std::shared_ptr<Call> call, Seconds timeout);
  void transmit(Call& call);
  void finish(const std::string& id, const std::function<void(Call&)>& settle);
  void failAll(const ErrorInfo& error);

  const MsgCallback callback_;
  const std::shared_ptr<Stream<std::function<void()>>> answers_;  // callbacks that are due
  std::map<std::string, std::shared_ptr<Call>> calls_;            // used in the thread of the event loop
};

/** Answers the calls of a service, one after the other. */
class ServiceProvider : public Interface, public std::enable_shared_from_this<ServiceProvider> {
 private:
  friend class Client;
  struct Request {
    std::string id;
    Value content;
  };
  ServiceProvider(std::shared_ptr<detail::Core> core, std::string tag, std::string type);
  void receive(Value data, std::map<std::string, Bytes> blobs) override;
  void ended(const std::optional<ErrorInfo>& error) override;
  void answer(const ServiceCallback& callback, const Request& request);

  const std::shared_ptr<Stream<Request>> requests_;
};

using ServiceClientPtr = std::shared_ptr<ServiceClient>;
using ServiceProviderPtr = std::shared_ptr<ServiceProvider>;

}  // namespace rce

// Handle of an environment, through which one robot uses its topics, services and actions.
#pragma once

#include "rce/actions.hpp"
#include "rce/services.hpp"

namespace rce {

class Client;

/** Environment as one robot uses it; made by Client::environment. */
class Environment {
 public:
  Environment(Client& client, std::string tag, Value options);

  const std::string& tag() const noexcept { return tag_; }

  /** Start the environment with its options; with `existOk` an existing one of that name is accepted. Waits. */
  void create(bool existOk = false);

  /** Stop the environment and remove everything in it. */
  std::future<void> destroy();

  // As the methods of Client.
  std::future<void> addNode(const std::string& nTag, const std::string& pkg, const std::string& exe,
                            const std::string& args = "", const std::string& name = "",
                            const std::string& rosNamespace = "", Value more = Value::object());
  std::future<void> removeNode(const std::string& nTag);
  std::future<void> addParameter(const std::string& name, Value value, const std::string& nTag = "");
  std::future<void> removeParameter(const std::string& name, const std::string& nTag = "");

  std::future<void> addRecorder(const std::string& rTag, std::vector<std::string> topics = {},
                                Value more = Value::object());
  std::future<void> removeRecorder(const std::string& rTag);

  // Interfaces of the robot, connected to a topic, service or action of the environment. They wait until it is there.
  PublisherPtr publisher(const std::string& topic, const std::string& msgType, InterfaceOptions options = {});
  SubscriberPtr subscriber(const std::string& topic, const std::string& msgType, InterfaceOptions options = {});
  SubscriberPtr subscriber(const std::string& topic, const std::string& msgType, MsgCallback callback,
                           InterfaceOptions options = {});
  ServiceClientPtr service(const std::string& service, const std::string& srvType, InterfaceOptions options = {});
  ServiceProviderPtr provider(const std::string& service, const std::string& srvType, ServiceCallback callback,
                              InterfaceOptions options = {});
  ActionClientPtr actionClient(const std::string& action, const std::string& actionType, InterfaceOptions options = {});
  ActionServerPtr actionServer(const std::string& action, const std::string& actionType, GoalCallback callback,
                               AcceptCallback accept = nullptr, InterfaceOptions options = {});

 private:
  std::string prefix() const;
  std::string connectTo(const std::string& address, const std::string& verb, const std::string& interfaceType,
                        const std::string& type, InterfaceOptions& options);

  Client& client_;
  std::string tag_;
  Value options_;
};

}  // namespace rce

#include "rce/environment.hpp"

#include <cctype>

#include "codec.hpp"
#include "rce/client.hpp"

namespace rce {
namespace {

/** The name of a topic or service as a part of a tag. */
std::string wordOf(const std::string& address) {
  std::string word;
  for (const char letter : address) {
    if (std::isalnum(static_cast<unsigned char>(letter)) || letter == '_') word += letter;
    else if (!word.empty() && word.back() != '_') word += '_';
  }
  const auto first = word.find_first_not_of('_'), last = word.find_last_not_of('_');
  return first == std::string::npos ? "" : word.substr(first, last - first + 1);
}

}  // namespace

Environment::Environment(Client& client, std::string tag, Value options)
    : client_(client), tag_(std::move(tag)), options_(std::move(options)) {}

void Environment::create(bool existOk) {
  try {
    client_.createContainer(tag_, options_).get();
  } catch (const AlreadyExists& error) {
    if (!existOk || detail::textOf(error.info().fields, "kind") == "robot") throw;
  }
}

std::future<void> Environment::destroy() { return client_.destroyContainer(tag_); }

std::future<void> Environment::addNode(const std::string& nTag, const std::string& pkg, const std::string& exe,
                                       const std::string& args, const std::string& name,
                                       const std::string& rosNamespace, Value more) {
  return client_.addNode(tag_, nTag, pkg, exe, args, name, rosNamespace, std::move(more));
}

std::future<void> Environment::removeNode(const std::string& nTag) { return client_.removeNode(tag_, nTag); }

std::future<void> Environment::addParameter(const std::string& name, Value value, const std::string& nTag) {
  return client_.addParameter(tag_, name, std::move(value), nTag);
}

std::future<void> Environment::removeParameter(const std::string& name, const std::string& nTag) {
  return client_.removeParameter(tag_, name, nTag);
}

std::future<void> Environment::addRecorder(const std::string& rTag, std::vector<std::string> topics, Value more) {
  return client_.addRecorder(tag_, rTag, std::move(topics), std::move(more));
}

std::future<void> Environment::removeRecorder(const std::string& rTag) { return client_.removeRecorder(tag_, rTag); }

PublisherPtr Environment::publisher(const std::string& topic, const std::string& msgType, InterfaceOptions options) {
  const std::string own = connectTo(topic, "pub", INTERFACE_PUBLISHER, msgType, options);
  return client_.publisher(own, msgType, options);
}

SubscriberPtr Environment::subscriber(const std::string& topic, const std::string& msgType, InterfaceOptions options) {
  return subscriber(topic, msgType, nullptr, std::move(options));
}

SubscriberPtr Environment::subscriber(const std::string& topic, const std::string& msgType, MsgCallback callback,
                                      InterfaceOptions options) {
  const std::string own = connectTo(topic, "sub", INTERFACE_SUBSCRIBER, msgType, options);
  return client_.subscriber(own, msgType, std::move(callback), options);
}

ServiceClientPtr Environment::service(const std::string& service, const std::string& srvType, InterfaceOptions options) {
  const std::string own = connectTo(service, "call", INTERFACE_SERVICE_CLIENT, srvType, options);
  return client_.service(own, srvType, options);
}

ServiceProviderPtr Environment::provider(const std::string& service, const std::string& srvType,
                                         ServiceCallback callback, InterfaceOptions options) {
  const std::string own = connectTo(service, "serve", INTERFACE_SERVICE_PROVIDER, srvType, options);
  return client_.provider(own, srvType, std::move(callback), options);
}

ActionClientPtr Environment::actionClient(const std::string& action, const std::string& actionType,
                                          InterfaceOptions options) {
  const std::string own = connectTo(action, "ask", "ActionClientInterface", actionType, options);
  return client_.actionClient(own, actionType, options);
}

ActionServerPtr Environment::actionServer(const std::string& action, const std::string& actionType,
                                          GoalCallback callback, AcceptCallback accept, InterfaceOptions options) {
  const std::string own = connectTo(action, "act", "ActionProviderInterface", actionType, options);
  return client_.actionServer(own, actionType, std::move(callback), std::move(accept), options);
}

/** Prefix of the names of what a guest makes in an environment. */
std::string Environment::prefix() const {
  return client_.robotID()[0] == '@' ? client_.robotID() + '.' : "";
}

/** Add the environment's interface unless it exists; sets `options.to`, and returns the tag of the robot's interface. */
std::string Environment::connectTo(const std::string& address, const std::string& verb,
                                   const std::string& interfaceType, const std::string& type,
                                   InterfaceOptions& options) {
  const std::string word = verb + '_' + wordOf(address);
  const std::string tag = prefix() + word;
  try {
    const Value more = options.qos.is_null() ? Value::object() : Value{{"qos", options.qos}};
    client_.addInterface(tag_, tag, interfaceType, type, address, more).get();
  } catch (const AlreadyExists&) {
    // if its type differs, connecting fails
  }
  options.to = tag_ + '/' + tag;
  return tag_ + '_' + word;
}

}  // namespace rce

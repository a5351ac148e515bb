#include "rce/client.hpp"

#include "core.hpp"

namespace rce {
namespace {

using detail::Done;

/** A future, and the function that settles it. */
std::pair<std::future<void>, Done> promised() {
  auto promise = std::make_shared<std::promise<void>>();
  return {promise->get_future(), [promise](const std::optional<ErrorInfo>& error) {
            if (error) promise->set_exception(exceptionOf(*error));
            else promise->set_value();
          }};
}

/** `item` without the texts that are empty, which the platform takes for given. */
Value given(Value item) {
  for (auto each = item.begin(); each != item.end();) {
    const bool isEmpty = each->is_null() || (each->is_string() && each->get_ref<const std::string&>().empty());
    each = isEmpty ? item.erase(each) : std::next(each);
  }
  return item;
}

Value with(Value item, const Value& more) {
  item = given(std::move(item));
  item.update(more);
  return item;
}

/** The first error of several commands, when all of them have been answered. */
struct Answers {
  Done done;
  std::size_t left;
  std::optional<std::pair<std::size_t, ErrorInfo>> first{};

  void add(std::size_t index, std::optional<ErrorInfo> error, bool isOnly) {
    if (error && (!first || index < first->first)) {
      if (!isOnly) error->item = "commands[" + std::to_string(index) + "]";
      first.emplace(index, std::move(*error));
    }
    if (--left == 0) done(first ? std::optional(first->second) : std::nullopt);
  }
};

Options optionsOf(std::string userID, std::string password, std::string robotID) {
  Options options;
  options.userID = std::move(userID);
  options.password = std::move(password);
  options.robotID = std::move(robotID);
  return options;
}

}  // namespace

Client::Client(std::string userID, std::string password, std::string robotID)
    : Client(optionsOf(std::move(userID), std::move(password), std::move(robotID))) {}

Client::Client(Options options) : core_(std::make_shared<detail::Core>(std::move(options))) {}

Client::~Client() { disconnect(); }

std::future<void> Client::connect(const std::string& url, ConnectCallback callback) {
  auto [future, done] = promised();
  core_->post([this, core = core_, url, callback = std::move(callback), done = done] {
    core->session().open(url, [this, core, callback, done](const std::optional<ErrorInfo>& error) {
      if (!error) core->opened();
      done(error);
      if (callback && !error) core->spawn([this, core, callback] { core->guarded([&] { callback(*this); }); });
    });
  });
  return std::move(future);
}

void Client::disconnect() { core_->stop(); }

bool Client::connected() const { return core_->connected(); }

const std::string& Client::robotID() const noexcept { return core_->options().robotID; }

std::shared_ptr<Stream<Event>> Client::events() { return core_->events(); }

void Client::onEvent(std::function<void(const Event&)> callback) { core_->serve(core_->events(), std::move(callback)); }

Environment Client::environment(std::string tag, Value options) {
  return Environment(*this, std::move(tag), std::move(options));
}

// --- commands

std::future<void> Client::execute(std::string list, Value item) {
  return configure({{std::move(list), std::move(item)}});
}

std::future<void> Client::configure(std::vector<Command> commands) {
  auto [future, done] = promised();
  if (commands.empty()) done(std::nullopt);
  core_->post([core = core_, commands = std::move(commands), done = done] {
    auto answers = std::make_shared<Answers>(Answers{done, commands.size()});
    for (std::size_t index = 0; index < commands.size(); ++index) {
      core->execute(commands[index], [answers, index, isOnly = commands.size() == 1](const std::optional<ErrorInfo>& error) {
        answers->add(index, error, isOnly);
      });
    }
  });
  return std::move(future);
}

std::future<void> Client::createContainer(const std::string& cTag, Value options) {
  return execute("CC", {{"containerTag", cTag}, {"containerData", std::move(options)}});
}

std::future<void> Client::destroyContainer(const std::string& cTag) { return execute("DC", {{"containerTag", cTag}}); }

std::future<void> Client::addNode(const std::string& cTag, const std::string& nTag, const std::string& pkg,
                                  const std::string& exe, const std::string& args, const std::string& name,
                                  const std::string& rosNamespace, Value more) {
  return execute("addNodes", with({{"containerTag", cTag}, {"nodeTag", nTag}, {"pkg", pkg}, {"exe", exe},
                                   {"args", args}, {"name", name}, {"namespace", rosNamespace}}, more));
}

std::future<void> Client::removeNode(const std::string& cTag, const std::string& nTag) {
  return execute("removeNodes", {{"containerTag", cTag}, {"nodeTag", nTag}});
}

std::future<void> Client::addParameter(const std::string& cTag, const std::string& name, Value value,
                                       const std::string& nTag) {
  Value item = given({{"containerTag", cTag}, {"name", name}, {"nodeTag", nTag}});
  item["value"] = std::move(value);
  return execute("setParam", std::move(item));
}

std::future<void> Client::removeParameter(const std::string& cTag, const std::string& name, const std::string& nTag) {
  return execute("deleteParam", given({{"containerTag", cTag}, {"name", name}, {"nodeTag", nTag}}));
}

std::future<void> Client::addInterface(const std::string& eTag, const std::string& iTag, const std::string& iType,
                                       const std::string& iCls, const std::string& addr, Value more) {
  return execute("addInterfaces", with({{"endpointTag", eTag}, {"interfaceTag", iTag}, {"interfaceType", iType},
                                        {"className", iCls}, {"addr", addr}}, more));
}

std::future<void> Client::removeInterface(const std::string& eTag, const std::string& iTag) {
  if (eTag == robotID()) core_->post([core = core_, iTag] { core->remove(iTag); });
  return execute("removeInterfaces", {{"endpointTag", eTag}, {"interfaceTag", iTag}});
}

std::future<void> Client::addRecorder(const std::string& cTag, const std::string& rTag, std::vector<std::string> topics,
                                      Value more) {
  Value item{{"containerTag", cTag}, {"recorderTag", rTag}, {"topics", std::move(topics)}};
  item.update(more);
  return execute("addRecorders", std::move(item));
}

std::future<void> Client::removeRecorder(const std::string& cTag, const std::string& rTag) {
  return execute("removeRecorders", {{"containerTag", cTag}, {"recorderTag", rTag}});
}

std::future<void> Client::addConnection(const std::string& tagA, const std::string& tagB) {
  return execute("connect", {{"tagA", tagA}, {"tagB", tagB}});
}

std::future<void> Client::addConnection(const std::string& eTag1, const std::string& iTag1, const std::string& eTag2,
                                        const std::string& iTag2) {
  return addConnection(eTag1 + '/' + iTag1, eTag2 + '/' + iTag2);
}

std::future<void> Client::removeConnection(const std::string& tagA, const std::string& tagB) {
  return execute("disconnect", {{"tagA", tagA}, {"tagB", tagB}});
}

std::future<void> Client::removeConnection(const std::string& eTag1, const std::string& iTag1,
                                           const std::string& eTag2, const std::string& iTag2) {
  return removeConnection(eTag1 + '/' + iTag1, eTag2 + '/' + iTag2);
}

// --- interfaces

/** Add the interface and connect it to `options.to`; remove it again if that fails. */
void Client::add(const std::shared_ptr<Interface>& added, const std::string& kind, const InterfaceOptions& options) {
  const std::string& tag = added->tag();
  std::promise<bool> isDeclared;
  core_->post([&] {
    if (core_->hasInterface(tag)) {
      const ErrorInfo error{"already_exists", robotID() + '/' + tag + " exists already: close it first"};
      return isDeclared.set_exception(exceptionOf(error));
    }
    core_->add(added);
    isDeclared.set_value(core_->isDeclared(robotID() + '/' + tag));
  });
  if (!isDeclared.get_future().get()) {
    try {
      const Value more = given({{"qos", options.qos}, {"format", options.format}});
      addInterface(robotID(), tag, kind + (options.raw ? "Forwarder" : "Converter"), added->type(), "", more).get();
    } catch (const Error&) {
      core_->post([core = core_, tag] { core->remove(tag); });
      throw;
    }
  }
  if (options.to.empty()) return;
  try {
    addConnection(options.to, robotID() + '/' + tag).get();
    if (!added->wasConnected()) added->waitConnected();  // its peer may have gone before the acknowledgement
  } catch (const Error&) {
    added->close();
    throw;
  }
}

PublisherPtr Client::publisher(const std::string& iTag, const std::string& msgType, const InterfaceOptions& options) {
  PublisherPtr made(new Publisher(core_, iTag, msgType, options.offline));
  add(made, "Subscriber", options);
  return made;
}

SubscriberPtr Client::subscriber(const std::string& iTag, const std::string& msgType, const InterfaceOptions& options) {
  return subscriber(iTag, msgType, nullptr, options);
}

SubscriberPtr Client::subscriber(const std::string& iTag, const std::string& msgType, MsgCallback callback,
                                 const InterfaceOptions& options) {
  SubscriberPtr made(new Subscriber(core_, iTag, msgType, options.depth));
  add(made, "Publisher", options);
  if (callback) core_->serve(made->messages_, std::move(callback));
  return made;
}

ServiceClientPtr Client::service(const std::string& iTag, const std::string& srvType, const InterfaceOptions& options) {
  return service(iTag, srvType, nullptr, options);
}

ServiceClientPtr Client::service(const std::string& iTag, const std::string& srvType, MsgCallback callback,
                                 const InterfaceOptions& options) {
  ServiceClientPtr made(new ServiceClient(core_, iTag, srvType, std::move(callback)));
  add(made, "ServiceProvider", options);
  core_->serve(made->answers_, [](const std::function<void()>& answer) { answer(); });
  return made;
}

ServiceProviderPtr Client::provider(const std::string& iTag, const std::string& srvType, ServiceCallback callback,
                                    const InterfaceOptions& options) {
  ServiceProviderPtr made(new ServiceProvider(core_, iTag, srvType));
  add(made, "ServiceClient", options);
  core_->serve(made->requests_, [made, callback = std::move(callback)](const ServiceProvider::Request& request) {
    made->answer(callback, request);
  });
  return made;
}

ActionClientPtr Client::actionClient(const std::string& iTag, const std::string& actionType,
                                     const InterfaceOptions& options) {
  ActionClientPtr made(new ActionClient(core_, iTag, actionType));
  add(made, "ActionProvider", options);
  return made;
}

ActionServerPtr Client::actionServer(const std::string& iTag, const std::string& actionType, GoalCallback callback,
                                     AcceptCallback accept, const InterfaceOptions& options) {
  ActionServerPtr made(new ActionServer(core_, iTag, actionType));
  add(made, "ActionClient", options);
  core_->serve(made->requests_, [made, callback = std::move(callback), accept = std::move(accept)](const ActionServer::Request& request) {
    made->start(callback, accept, request);
  });
  return made;
}

// --- services of the catalogue

UsedServicePtr Client::use(const std::string& name, const std::string& tag, bool raw) {
  const std::string own = tag.empty() ? name.substr(name.rfind('/') + 1) : tag;
  auto promise = std::make_shared<std::promise<UsedServicePtr>>();
  auto used = std::make_shared<UsedServicePtr>();
  auto future = promise->get_future();
  core_->post([=, core = core_] {
    if (core->isUsed(own)) {
      const ErrorInfo error{"already_exists", "this robot uses a service as " + own + " already: give another tag"};
      return promise->set_exception(exceptionOf(error));
    }
    core->expect(own + '_');
    const auto done = [=](const std::optional<ErrorInfo>& error) {
      core->adopt(own + '_');
      if (error) return promise->set_exception(exceptionOf(*error));
      const ErrorInfo old{"unavailable", "this platform has no catalogue of services: it is older than this client"};
      if (*used) promise->set_value(*used);
      else promise->set_exception(exceptionOf(old));
    };
    core->execute({"useServices", {{"service", name}, {"containerTag", own}, {"raw", raw}}}, done,
                  [=](const Value& acknowledged) { *used = adopt(acknowledged); });
  });
  return future.get();
}

/** Make the interfaces of a service from its acknowledgement; null if it names none. */
UsedServicePtr Client::adopt(const Value& acknowledged) {
  const auto services = acknowledged.find("services");
  if (services == acknowledged.end() || !services->is_array() || services->empty()) return nullptr;
  const Value& first = services->front();
  UsedServicePtr used(new UsedService(core_, first));
  for (const Value& each : first.value("interfaces", Value::array())) {
    if (auto made = make(each)) used->interfaces_.emplace(detail::textOf(each, "name"), std::move(made));
  }
  return used;
}

/** Make the robot's end of an interface, whose type is named from the cloud's point of view; null of an unknown type. */
std::shared_ptr<Interface> Client::make(const Value& used) {
  const std::string tag = detail::textOf(used, "iTag"), type = detail::textOf(used, "className");
  const std::string kind = detail::textOf(used, "interfaceType");
  std::shared_ptr<Interface> made;
  if (kind.rfind("Subscriber", 0) == 0) made.reset(new Publisher(core_, tag, type, Offline::drop));
  else if (kind.rfind("Publisher", 0) == 0) made.reset(new Subscriber(core_, tag, type, 0));
  else if (kind.rfind("ActionProvider", 0) == 0) made.reset(new ActionClient(core_, tag, type));
  else if (kind.rfind("ServiceProvider", 0) == 0) {
    ServiceClientPtr client(new ServiceClient(core_, tag, type, nullptr));
    core_->serve(client->answers_, [](const std::function<void()>& answer) { answer(); });
    made = std::move(client);
  }
  if (made) core_->add(made, true);
  return made;
}

}  // namespace rce

// Client library of RCE: a robot that is connected to a platform. See docs/cpp.md.
#pragma once

#include <vector>

#include "rce/actions.hpp"
#include "rce/catalogue.hpp"
#include "rce/environment.hpp"
#include "rce/services.hpp"

namespace rce {

/** Identity and credentials of a robot. Give either a password or an API key. */
struct Options {
  std::string userID{};
  std::string robotID{};  // one that begins with `@` is a guest
  std::string password{};
  std::string key{};
  std::string owner{};    // whose data a guest takes part in; empty for the user's own
  std::string caFile{};   // certificates (PEM) to trust besides those of the system
  Seconds timeout{60};    // of each command
  Seconds nameWait{20};   // for which `connect` tries again while the robotID is in use
};

/** An item of a CN or CX list, or a CC or DC, with the names of docs/protocol.md. */
struct Command {
  std::string list;
  Value item;
  bool operator==(const Command& other) const { return list == other.list && item == other.item; }
};

/** Event of a robot; `topic` is one of docs/protocol.md (Features), or `disconnected`, `reconnected`, `error`. */
struct Event {
  std::string topic;
  Value data;  // of an error: code, message, item, field, fields
};

// The types of interfaces, named as in the original.
inline constexpr const char* INTERFACE_SERVICE_CLIENT = "ServiceClientInterface";
inline constexpr const char* INTERFACE_SERVICE_PROVIDER = "ServiceProviderInterface";
inline constexpr const char* INTERFACE_PUBLISHER = "PublisherInterface";
inline constexpr const char* INTERFACE_SUBSCRIBER = "SubscriberInterface";
inline constexpr const char* CONVERTER_SERVICE_CLIENT = "ServiceClientConverter";
inline constexpr const char* CONVERTER_SERVICE_PROVIDER = "ServiceProviderConverter";
inline constexpr const char* CONVERTER_PUBLISHER = "PublisherConverter";
inline constexpr const char* CONVERTER_SUBSCRIBER = "SubscriberConverter";
inline constexpr const char* FORWARDER_SERVICE_CLIENT = "ServiceClientForwarder";
inline constexpr const char* FORWARDER_SERVICE_PROVIDER = "ServiceProviderForwarder";
inline constexpr const char* FORWARDER_PUBLISHER = "PublisherForwarder";
inline constexpr const char* FORWARDER_SUBSCRIBER = "SubscriberForwarder";

/**
 * Robot that is connected to a platform. All methods are thread-safe, also in callbacks.
 *
 * A callback of an interface runs in a thread of that interface, in the order of the messages; it may block and may call
 * the client. An exception of a callback becomes an `error` event, or the answer to a call. The destructor disconnects.
 */
class Client {
 public:
  using ConnectCallback = std::function<void(Client& client)>;

  Client(std::string userID, std::string password, std::string robotID);
  explicit Client(Options options);
  ~Client();
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  /**
   * Connect to the platform whose entry has this URL; those of several Masters are separated by commas. The future has
   * Unauthorized, Forbidden, Unavailable, InvalidRequest, or AlreadyExists (the name is in use). The callback, if any, is
   * called in a thread of its own.
   */
  std::future<void> connect(const std::string& url, ConnectCallback callback = nullptr);

  /** Send the queued messages and leave, after the running callbacks have ended. Environments stay. */
  void disconnect();

  /** True while the robot is online. */
  bool connected() const;

  const std::string& robotID() const noexcept;

  /** A new stream of the events from now on. */
  std::shared_ptr<Stream<Event>> events();

  /** Call a function with each event from now on. */
  void onEvent(std::function<void(const Event&)> callback);

  /** A handle of an environment, which may exist already; nothing is sent. It must not outlive the client. */
  Environment environment(std::string tag, Value options = Value::object());

  // Commands. Each future is ready when the command has been executed, or has its error. It may be ignored.

  std::future<void> createContainer(const std::string& cTag, Value options = Value::object());
  std::future<void> destroyContainer(const std::string& cTag);
  /** `more` has `existOk` and `restart`, as in docs/protocol.md. */
  std::future<void> addNode(const std::string& cTag, const std::string& nTag, const std::string& pkg,
                            const std::string& exe, const std::string& args = "", const std::string& name = "",
                            const std::string& rosNamespace = "", Value more = Value::object());
  std::future<void> removeNode(const std::string& cTag, const std::string& nTag);
  std::future<void> addParameter(const std::string& cTag, const std::string& name, Value value,
                                 const std::string& nTag = "");
  std::future<void> removeParameter(const std::string& cTag, const std::string& name, const std::string& nTag = "");
  /** `more` has `qos` and `format`, as in docs/protocol.md. */
  std::future<void> addInterface(const std::string& eTag, const std::string& iTag, const std::string& iType,
                                 const std::string& iCls, const std::string& addr = "", Value more = Value::object());
  std::future<void> removeInterface(const std::string& eTag, const std::string& iTag);
  /** Record topics of an environment on its machine, all of them if there are none; `more` has `maxSize` and so on. */
  std::future<void> addRecorder(const std::string& cTag, const std::string& rTag, std::vector<std::string> topics = {},
                                Value more = Value::object());
  std::future<void> removeRecorder(const std::string& cTag, const std::string& rTag);
  std::future<void> addConnection(const std::string& tagA, const std::string& tagB);
  std::future<void> addConnection(const std::string& eTag1, const std::string& iTag1, const std::string& eTag2,
                                  const std::string& iTag2);
  std::future<void> removeConnection(const std::string& tagA, const std::string& tagB);
  std::future<void> removeConnection(const std::string& eTag1, const std::string& iTag1, const std::string& eTag2,
                                     const std::string& iTag2);

  /**
   * Execute commands in order, without waiting for one before the next is sent. A failed one does not stop the others;
   * then the future has the first error, whose `item` (`commands[2]`) names the command.
   */
  std::future<void> configure(std::vector<Command> commands);

  // Interfaces of the robot. These methods wait until the interface exists and, with `to`, is connected. One that
  // `addInterface` has added already is used as it is.

  PublisherPtr publisher(const std::string& iTag, const std::string& msgType, const InterfaceOptions& options = {});
  SubscriberPtr subscriber(const std::string& iTag, const std::string& msgType, const InterfaceOptions& options = {});
  SubscriberPtr subscriber(const std::string& iTag, const std::string& msgType, MsgCallback callback,
                           const InterfaceOptions& options = {});
  ServiceClientPtr service(const std::string& iTag, const std::string& srvType, const InterfaceOptions& options = {});
  /** The callback gets each response, as in the original. */
  ServiceClientPtr service(const std::string& iTag, const std::string& srvType, MsgCallback callback,
                           const InterfaceOptions& options = {});
  ServiceProviderPtr provider(const std::string& iTag, const std::string& srvType, ServiceCallback callback,
                              const InterfaceOptions& options = {});
  ActionClientPtr actionClient(const std::string& iTag, const std::string& actionType,
                               const InterfaceOptions& options = {});
  ActionServerPtr actionServer(const std::string& iTag, const std::string& actionType, GoalCallback callback,
                               AcceptCallback accept = nullptr, const InterfaceOptions& options = {});

  /**
   * Use a service of the catalogue, which is started if needed, and wait for it. `tag` begins the names of the robot's
   * interfaces, and is by default the name of the service; with `raw` their messages are bytes: CDR, unchanged.
   */
  UsedServicePtr use(const std::string& name, const std::string& tag = "", bool raw = false);

 private:
  friend struct ClientAccess;  // of the tests
  std::future<void> execute(std::string list, Value item);
  UsedServicePtr adopt(const Value& acknowledged);
  std::shared_ptr<Interface> make(const Value& used);
  void add(const std::shared_ptr<Interface>& added, const std::string& kind, const InterfaceOptions& options);

  const std::shared_ptr<detail::Core> core_;
};

using ClientPtr = std::shared_ptr<Client>;
using ConnectCallback = Client::ConnectCallback;

}  // namespace rce

// Services of the platform's catalogue, made by Client::use.
#pragma once

#include "rce/actions.hpp"
#include "rce/services.hpp"

namespace rce {

/** Service of the catalogue that a robot uses. After a lost session the robot asks for it again. Thread-safe. */
class UsedService {
 public:
  UsedService(const UsedService&) = delete;
  UsedService& operator=(const UsedService&) = delete;

  /** `user/name`, or the name alone of a service that comes with RCE. */
  const std::string& name() const noexcept { return name_; }

  /** Begins the names of the robot's interfaces; name of the environment if the service is not shared. */
  const std::string& tag() const noexcept { return tag_; }

  /** True if the instance may serve other robots too, also those of other users. */
  bool isShared() const noexcept { return shared_; }

  // The robot's interfaces, by the names in the declaration of the service. They throw NotFound if there is none.
  PublisherPtr publisher(const std::string& name) const;
  SubscriberPtr subscriber(const std::string& name) const;
  ServiceClientPtr service(const std::string& name) const;
  ActionClientPtr actionClient(const std::string& name) const;

  /** Use the service no longer, and wait for that: its interfaces are removed; reads and calls end at once. */
  void leave();

 private:
  friend class Client;
  UsedService(std::shared_ptr<detail::Core> core, const Value& used);

  template <class Kind>
  std::shared_ptr<Kind> find(const std::string& name, const char* kind) const;

  const std::shared_ptr<detail::Core> core_;
  std::string name_;
  std::string tag_;
  bool shared_ = false;
  std::map<std::string, std::shared_ptr<Interface>> interfaces_;
};

using UsedServicePtr = std::shared_ptr<UsedService>;

}  // namespace rce

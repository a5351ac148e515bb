#include "rce/catalogue.hpp"

#include "core.hpp"

namespace rce {

UsedService::UsedService(std::shared_ptr<detail::Core> core, const Value& used)
    : core_(std::move(core)),
      name_(detail::textOf(used, "service")),
      tag_(detail::textOf(used, "containerTag")),
      shared_(used.value("shared", false)) {}

PublisherPtr UsedService::publisher(const std::string& name) const { return find<Publisher>(name, "publisher"); }

SubscriberPtr UsedService::subscriber(const std::string& name) const { return find<Subscriber>(name, "subscriber"); }

ServiceClientPtr UsedService::service(const std::string& name) const {
  return find<ServiceClient>(name, "service client");
}

ActionClientPtr UsedService::actionClient(const std::string& name) const {
  return find<ActionClient>(name, "action client");
}

template <class Kind>
std::shared_ptr<Kind> UsedService::find(const std::string& name, const char* kind) const {
  const auto found = interfaces_.find(name);
  auto wanted = found == interfaces_.end() ? nullptr : std::dynamic_pointer_cast<Kind>(found->second);
  if (!wanted) raise({"not_found", name_ + " has no " + kind + ' ' + name});
  return wanted;
}

void UsedService::leave() {
  auto left = std::make_shared<std::promise<void>>();
  core_->post([this, left] {
    for (const auto& [name, each] : interfaces_) core_->remove(each->tag());
    core_->execute({"leaveServices", {{"containerTag", tag_}}}, [left](const std::optional<ErrorInfo>& error) {
      if (error && error->code != "not_found") left->set_exception(exceptionOf(*error));
      else left->set_value();
    });
  });
  left->get_future().get();
}

}  // namespace rce

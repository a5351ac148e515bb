#include "rce/errors.hpp"

#include <map>

namespace rce {
namespace {

template <class Kind>
std::exception_ptr make(const ErrorInfo& info) {
  return std::make_exception_ptr(Kind(info));
}

using Maker = std::exception_ptr (*)(const ErrorInfo&);

const std::map<std::string, Maker>& makers() {
  static const std::map<std::string, Maker> table{
      {"invalid_request", make<InvalidRequest>}, {"invalid_name", make<InvalidName>},
      {"conversion", make<ConversionError>},     {"unknown_type", make<UnknownType>},
      {"not_found", make<NotFound>},             {"already_exists", make<AlreadyExists>},
      {"not_connectable", make<NotConnectable>}, {"not_connected", make<NotConnected>},
      {"unauthorized", make<Unauthorized>},      {"too_many_attempts", make<TooManyAttempts>},
      {"forbidden", make<Forbidden>},
      {"no_capacity", make<NoCapacity>},         {"limit_exceeded", make<LimitExceeded>},
      {"start_failed", make<StartFailed>},       {"died", make<Died>},
      {"unavailable", make<Unavailable>},        {"lost", make<Lost>},
      {"timed_out", make<TimedOut>},             {"internal", make<InternalError>}};
  return table;
}

}  // namespace

std::exception_ptr exceptionOf(const ErrorInfo& info) {
  const auto found = makers().find(info.code);
  return found == makers().end() ? make<Error>(info) : found->second(info);
}

void raise(const ErrorInfo& info) { std::rethrow_exception(exceptionOf(info)); }

}  // namespace rce

// Errors, with the classes and codes of the Python client (docs/client.md).
#pragma once

#include <exception>
#include <memory>
#include <stdexcept>
#include <string>

#include "rce/values.hpp"

namespace rce {

/** An error as it travels: `item` is `list[index]` of a command's item, `field` the path of the field at fault. */
struct ErrorInfo {
  std::string code;
  std::string message;
  std::string item{};
  std::string field{};
  Value fields = Value::object();
};

/** Base of all errors of this library. */
class Error : public std::runtime_error {
 public:
  explicit Error(const ErrorInfo& info)
      : std::runtime_error(info.message), info_(std::make_shared<const ErrorInfo>(info)) {}

  const ErrorInfo& info() const noexcept { return *info_; }
  const std::string& code() const noexcept { return info_->code; }
  const std::string& item() const noexcept { return info_->item; }
  const std::string& field() const noexcept { return info_->field; }

 private:
  std::shared_ptr<const ErrorInfo> info_;  // copies of an exception must not throw
};

class InvalidRequest : public Error { public: using Error::Error; };
class InvalidName : public InvalidRequest { public: using InvalidRequest::InvalidRequest; };
class ConversionError : public InvalidRequest { public: using InvalidRequest::InvalidRequest; };
class UnknownType : public InvalidRequest { public: using InvalidRequest::InvalidRequest; };
class NotFound : public Error { public: using Error::Error; };
class AlreadyExists : public Error { public: using Error::Error; };
class NotConnectable : public Error { public: using Error::Error; };
class NotConnected : public Error { public: using Error::Error; };
class Unauthorized : public Error { public: using Error::Error; };
class TooManyAttempts : public Error { public: using Error::Error; };
class Forbidden : public Error { public: using Error::Error; };
class NoCapacity : public Error { public: using Error::Error; };
class LimitExceeded : public Error { public: using Error::Error; };
class StartFailed : public Error { public: using Error::Error; };
class Died : public Error { public: using Error::Error; };
class Unavailable : public Error { public: using Error::Error; };
class Lost : public Unavailable { public: using Unavailable::Unavailable; };
class TimedOut : public Error { public: using Error::Error; };
class InternalError : public Error { public: using Error::Error; };

/** The exception of the class for the code; a code that this version does not know becomes a plain Error. */
std::exception_ptr exceptionOf(const ErrorInfo& info);

/** Throw `exceptionOf(info)`. */
[[noreturn]] void raise(const ErrorInfo& info);

}  // namespace rce

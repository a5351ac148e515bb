// JSON of values, faster than by nlohmann: simdjson parses, and texts are copied up to the next character to escape.
#pragma once

#include <string>
#include <string_view>

#include "rce/values.hpp"

namespace rce::detail {

/** Parse JSON. Returns a discarded value for text that is not JSON. */
Value parseJson(std::string_view text);

/** Write JSON, with null for NaN and infinities. Throws Value::exception for text that is not UTF-8. */
std::string writeJson(const Value& value);

}  // namespace rce::detail

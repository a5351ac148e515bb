// JSON of values, faster than by nlohmann: simdjson parses, and texts are copied up to the next character to escape.
#pragma once

#include <string>
#include <string_view>

#include "rce/values.hpp"

namespace rce::detail {

constexpr std::size_t PADDING = 64;

/** Text in a longer buffer: PADDING bytes behind it can be read, too. simdjson reads them, and ignores what they are. */
struct PaddedText {
  std::string_view text;
};

/** Parse JSON. Returns a discarded value for text that is not JSON. */
Value parseJson(PaddedText padded);

/** Write JSON, with null for NaN and infinities. Throws Value::exception for text that is not UTF-8. */
std::string writeJson(const Value& value);

}  // namespace rce::detail

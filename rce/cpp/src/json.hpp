// JSON text of values: parsed by simdjson, and written with runs of text copied at once. nlohmann's parser and writer
// handle each byte by itself, which takes several times as long for texts and arrays of 100 kB.
#pragma once

#include <string>
#include <string_view>

#include "rce/values.hpp"

namespace rce::detail {

/** Parse JSON. Returns a discarded value for text that is not JSON. */
Value parseJson(std::string_view text);

/** Write JSON as nlohmann does. Throws Value::exception for text that is not UTF-8. */
std::string writeJson(const Value& value);

}  // namespace rce::detail

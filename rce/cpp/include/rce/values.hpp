// Values of messages: JSON, in which bytes are binary values.
#pragma once

#include <chrono>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <vector>

namespace rce {

/** JSON value. Bytes are `Value::binary(…)`: they travel as blobs, not as text. Read them with `get_binary()`. */
using Value = nlohmann::json;
using Bytes = std::vector<std::uint8_t>;
using Seconds = std::chrono::duration<double>;

constexpr Seconds connectTimeout{10};
constexpr Seconds forever{1e9};

}  // namespace rce

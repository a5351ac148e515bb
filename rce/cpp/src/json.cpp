#include "json.hpp"

#include <simdjson.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace rce::detail {
namespace {

namespace ondemand = simdjson::ondemand;

constexpr int DEEPEST = 100;        // levels of nesting; nlohmann's parser reads deeper texts, without recursion
constexpr std::size_t ROOM = 4096;  // bytes reserved behind a text, so that its closing quote does not reallocate it

/** The text of an element. Without escapes it is copied once, from the source. */
Value stringOf(ondemand::value& element) {
  std::string_view token = element.raw_json_token();  // in quotes, with the space behind them
  token = token.substr(1, token.rfind('"') - 1);
  if (token.find('\\') != std::string_view::npos) return std::string(std::string_view(element.get_string()));
  element.get_raw_json_string().value();  // consumes it: otherwise simdjson would accept a colon behind it
  return std::string(token);
}

/** Each type is read by its own function: `get_number` of simdjson 3.0 reads floats of many digits wrongly. */
Value numberOf(ondemand::value& element) {
  switch (element.get_number_type().value()) {
    case ondemand::number_type::signed_integer: return element.get_int64().value();
    case ondemand::number_type::unsigned_integer: return element.get_uint64().value();
    case ondemand::number_type::floating_point_number: break;
  }
  return element.get_double().value();
}

/** The value of an element. Throws simdjson_error. */
Value valueOf(ondemand::value element, int depth) {
  if (depth > DEEPEST) throw simdjson::simdjson_error(simdjson::DEPTH_ERROR);
  switch (element.type().value()) {
    case ondemand::json_type::array: {
      Value::array_t array;
      for (auto item : element.get_array()) array.push_back(valueOf(item.value(), depth + 1));
      return array;
    }
    case ondemand::json_type::object: {
      Value::object_t object;
      for (auto field : element.get_object()) {
        std::string key(std::string_view(field.unescaped_key()));
        object.insert_or_assign(std::move(key), valueOf(field.value(), depth + 1));
      }
      return object;
    }
    case ondemand::json_type::number: return numberOf(element);
    case ondemand::json_type::string: return stringOf(element);
    case ondemand::json_type::boolean: return bool(element.get_bool());
    case ondemand::json_type::null:
      if (element.is_null()) return nullptr;
  }
  throw simdjson::simdjson_error(simdjson::TAPE_ERROR);
}

class Writer {
 public:
  explicit Writer(std::string& out) : out_(out) {}

  void write(const Value& value) {
    switch (value.type()) {
      case Value::value_t::object: return writeObject(value.get_ref<const Value::object_t&>());
      case Value::value_t::array: return writeArray(value.get_ref<const Value::array_t&>());
      case Value::value_t::string: return writeText(value.get_ref<const std::string&>());
      case Value::value_t::number_integer: return writeNumber(value.get<std::int64_t>());
      case Value::value_t::number_unsigned: return writeNumber(value.get<std::uint64_t>());
      case Value::value_t::number_float:
        if (std::isfinite(value.get<double>())) return writeNumber(value.get<double>());
        [[fallthrough]];
      default: out_ += value.dump();
    }
  }

 private:
  void writeObject(const Value::object_t& object) {
    char before = '{';
    for (const auto& [key, item] : object) {
      out_ += before;
      writeText(key);
      out_ += ':';
      write(item);
      before = ',';
    }
    out_ += object.empty() ? "{}" : "}";
  }

  void writeArray(const Value::array_t& array) {
    char before = '[';
    for (const Value& item : array) {
      out_ += before;
      write(item);
      before = ',';
    }
    out_ += array.empty() ? "[]" : "]";
  }

  void writeText(const std::string& text) {
    if (!simdjson::validate_utf8(text)) {
      out_ += Value(text).dump();  // throws an error that names the byte
      return;
    }
    out_.reserve(out_.size() + text.size() + ROOM);
    out_ += '"';
    for (std::size_t done = 0; done < text.size();) {
      const std::size_t end = plainUntil(text, done);
      out_.append(text, done, end - done);
      if (end < text.size()) writeEscape(text[end]);
      done = end + 1;
    }
    out_ += '"';
  }

  static bool isEscaped(char each) { return static_cast<unsigned char>(each) < 0x20 || each == '"' || each == '\\'; }

  /** The place of the first byte from `start` on that is escaped, or the size of the text. */
  static std::size_t plainUntil(const std::string& text, std::size_t start) {
    constexpr std::size_t block = 64;
    for (; start + block <= text.size(); start += block) {
      std::uint8_t escaped = 0;  // g++ vectorises the loop for bytes, not for bool
      for (std::size_t i = 0; i < block; ++i) escaped = static_cast<std::uint8_t>(escaped | isEscaped(text[start + i]));
      if (escaped != 0) break;
    }
    while (start < text.size() && !isEscaped(text[start])) ++start;
    return start;
  }

  void writeEscape(char each) {
    const std::string dumped = Value(std::string(1, each)).dump();  // in quotes
    out_.append(dumped, 1, dumped.size() - 2);
  }

  template <typename Number>
  void writeNumber(Number number) {
    std::array<char, 32> digits{};
    char* const end = std::to_chars(digits.data(), digits.data() + digits.size(), number).ptr;
    out_.append(digits.data(), end);
    if constexpr (std::is_floating_point_v<Number>) {
      if (std::none_of(digits.data(), end, [](char each) { return each == '.' || each == 'e'; })) out_ += ".0";
    }
  }

  std::string& out_;
};

}  // namespace

Value parseJson(PaddedText padded) {
  static_assert(PADDING >= simdjson::SIMDJSON_PADDING);
  const std::string_view text = padded.text;
  try {
    ondemand::parser parser;
    ondemand::document document = parser.iterate(text.data(), text.size(), text.size() + PADDING);
    Value value = valueOf(document.get_value().value(), 1);
    if (document.current_location().error() == simdjson::OUT_OF_BOUNDS) return value;  // nothing follows
  } catch (const simdjson::simdjson_error&) {
    // not JSON, or something that only nlohmann's parser accepts: a scalar at the top, an integer of more than 64 bits
  }
  return Value::parse(text, nullptr, false);
}

std::string writeJson(const Value& value) {
  std::string out;
  Writer(out).write(value);
  return out;
}

}  // namespace rce::detail

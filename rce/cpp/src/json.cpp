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

namespace dom = simdjson::dom;

Value valueOf(const dom::element& element) {
  switch (element.type()) {
    case dom::element_type::ARRAY: {
      const dom::array items(element);
      Value::array_t array;
      array.reserve(items.size());
      for (const dom::element item : items) array.push_back(valueOf(item));
      return array;
    }
    case dom::element_type::OBJECT: {
      Value::object_t object;
      for (const auto& [key, item] : dom::object(element)) object.insert_or_assign(std::string(key), valueOf(item));
      return object;
    }
    case dom::element_type::INT64: return std::int64_t(element);
    case dom::element_type::UINT64: return std::uint64_t(element);
    case dom::element_type::DOUBLE: return double(element);
    case dom::element_type::STRING: return std::string(std::string_view(element));
    case dom::element_type::BOOL: return bool(element);
    case dom::element_type::NULL_VALUE: break;
  }
  return nullptr;
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
    constexpr std::size_t block = 32;  // compilers use vectors for it
    for (; start + block <= text.size(); start += block) {
      bool escaped = false;
      for (std::size_t i = 0; i < block; ++i) escaped |= isEscaped(text[start + i]);
      if (escaped) break;
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

Value parseJson(std::string_view text) {
  dom::parser parser;
  dom::element root;
  if (parser.parse(text.data(), text.size()).get(root) == simdjson::SUCCESS) return valueOf(root);
  return Value::parse(text, nullptr, false);  // simdjson refuses integers of more than 64 bits
}

std::string writeJson(const Value& value) {
  std::string out;
  Writer(out).write(value);
  return out;
}

}  // namespace rce::detail

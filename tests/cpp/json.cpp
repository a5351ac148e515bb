// JSON of the library beside that of nlohmann: random values, and texts at the limits.
#include "json.hpp"

#include <cmath>
#include <iostream>
#include <limits>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

using rce::Value;
using rce::detail::PADDING;
using rce::detail::writeJson;

namespace {

void check(bool holds, const std::string& what) {
  if (!holds) throw std::runtime_error(what);
}

Value parseJson(std::string text) {
  text.reserve(text.size() + PADDING);
  return rce::detail::parseJson({text});
}

class Values {
 public:
  Value any(int depth) {
    switch (number(depth > 0 ? 8 : 6)) {
      case 0: return nullptr;
      case 1: return number(2) == 0;
      case 2: return static_cast<std::int64_t>(random_());
      case 3: return random_();
      case 4: return std::ldexp(static_cast<double>(random_()), static_cast<int>(number(400)) - 200);
      case 5: return text();
      case 6: return array(depth);
      default: return object(depth);
    }
  }

  std::string text() {
    static const std::vector<std::string> pieces{"a", "plain text of more than thirty-two bytes", "\"", "\\", "\n", "\x01",
                                                 "\x7f", "\xc3\xa9", "\xe2\x82\xac", "\xf0\x9f\xa4\x96", "/", "*"};
    std::string result;
    for (std::size_t left = number(6); left > 0; --left) result += pieces[number(pieces.size())];
    return result;
  }

 private:
  std::size_t number(std::size_t below) { return random_() % below; }

  Value array(int depth) {
    Value result = Value::array();
    for (std::size_t left = number(5); left > 0; --left) result.push_back(any(depth - 1));
    return result;
  }

  Value object(int depth) {
    Value result = Value::object();
    for (std::size_t left = number(5); left > 0; --left) result[text()] = any(depth - 1);
    return result;
  }

  std::mt19937_64 random_{1};
};

void checkValues() {
  Values values;
  for (int count = 0; count < 5000; ++count) {
    const Value value = values.any(4);
    check(parseJson(value.dump()) == value, "parsed: " + value.dump());
    check(Value::parse(writeJson(value)) == value, "written: " + writeJson(value));
  }
  for (const double number : {0.0, -0.0, 1.0, 1e20, 1e-7, 5e-324, 1.7976931348623157e308, 0.1}) {
    check(Value::parse(writeJson(number)).is_number_float(), "a float stays one: " + writeJson(number));
    check(parseJson(writeJson(number)) == Value(number), "float: " + writeJson(number));
  }
  check(writeJson(std::numeric_limits<double>::quiet_NaN()) == "null", "NaN");
  check(writeJson(Value::parse(R"({"b":[1,-2,true,null,""],"a":{}})")) == R"({"a":{},"b":[1,-2,true,null,""]})", "order");
}

void checkText(const std::string& text) {
  const Value expected = Value::parse(text, nullptr, false), found = parseJson(text);
  check(found.is_discarded() == expected.is_discarded(), "accepted or not: " + text);
  check(found.is_discarded() || found == expected, "text: " + text);
}

/** Check texts of which one byte was replaced, removed or repeated. */
void checkDamagedTexts() {
  Values values;
  std::mt19937_64 random{2};
  const std::string bytes = "{}[]\",:0-.eEtfn\\u \n\x01\x80z";
  for (int count = 0; count < 20000; ++count) {
    std::string text = Value::array({values.any(3), values.any(2)}).dump();
    const std::size_t place = random() % text.size();
    if (count % 3 == 0) text[place] = bytes[random() % bytes.size()];
    else if (count % 3 == 1) text.erase(place, 1);
    else text.insert(place, 1, text[place]);
    checkText(text);
  }
}

void checkTexts() {
  const std::string nested(2000, '['), closed(2000, ']');
  for (const std::string& text :
       {std::string(), std::string("{"), std::string("[1,]"), std::string("NaN"), std::string("\"\xff\""),
        std::string("\"\\ud800\""), std::string("\"\n\""), std::string("1 2"), std::string("01"), std::string("\0", 1),
        std::string("123456789012345678901234567890"), std::string("1e400"), std::string(" [ 1 , 2 ] "),
        std::string(R"("\ud83e\udd16\u0000")"), std::string(R"({"a":1,"a":2})"),
        std::string("{} 1"), std::string("{}}"), std::string("[[]"), std::string(R"( [ "a" , "b\"" ] )"),
        std::string("[123456789012345678901234567890, \"a\"]"),
        std::string("[109988641498979230369.091175947673399e-08]"), nested, nested + closed}) {
    checkText(text);
  }
  try {
    writeJson({{"a", "\xff"}});
    check(false, "text that is not UTF-8 is refused");
  } catch (const Value::exception&) {
  }
}

}  // namespace

int main() {
  checkValues();
  checkTexts();
  checkDamagedTexts();
  std::cout << "all values are equal\n";
}

#include "codec.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

namespace rce::detail {
namespace {

bool isFinite(const Value& value) { return !value.is_number_float() || std::isfinite(value.get<double>()); }

const char* nameOf(double number) { return std::isnan(number) ? "NaN" : number > 0 ? "Infinity" : "-Infinity"; }

bool isReference(const std::string& key) { return !key.empty() && key.back() == '*'; }

bool isListOfBytes(const Value& value) {
  return value.is_array() && !value.empty() &&
         std::all_of(value.begin(), value.end(), [](const Value& each) { return each.is_binary(); });
}

/** Replace bytes by new ids (`key` becomes `key*`), and numbers that JSON cannot express by their names. */
class Detacher {
 public:
  explicit Detacher(std::vector<Blob>& blobs) : blobs_(blobs) {}

  void detach(Value& value) {
    if (value.is_object()) {
      detachObject(value);
    } else if (value.is_array()) {
      for (Value& each : value) detach(each);
    } else if (!isFinite(value)) {
      value = nameOf(value.get<double>());
    }
  }

 private:
  void detachObject(Value& object) {
    std::vector<std::string> keys;
    for (const auto& [key, item] : object.items()) {
      if (item.is_binary() || isListOfBytes(item)) keys.push_back(key);
    }
    for (const std::string& key : keys) {
      Value item = std::move(object[key]);
      object.erase(key);
      object[key + "*"] = keep(item);
    }
    for (Value& each : object) detach(each);
  }

  Value keep(Value& item) {
    if (item.is_array()) {
      Value ids = Value::array();
      for (Value& each : item) ids.push_back(keep(each));
      return ids;
    }
    std::string id = freshId();
    blobs_.push_back({id, std::make_shared<const Bytes>(std::move(static_cast<Bytes&>(item.get_binary())))});
    return id;
  }

  std::vector<Blob>& blobs_;
};

void collect(const Value& value, std::set<std::string>& found) {
  if (value.is_array()) {
    for (const Value& each : value) collect(each, found);
  } else if (value.is_object()) {
    for (const auto& [key, item] : value.items()) {
      if (!isReference(key)) {
        collect(item, found);
      } else if (item.is_string()) {
        found.insert(item.get<std::string>());
      } else if (item.is_array()) {
        for (const Value& id : item) {
          if (id.is_string()) found.insert(id.get<std::string>());
        }
      }
    }
  }
}

Value blobsOf(const Value& ids, BlobsById& blobs) {
  if (ids.is_string()) {
    const auto found = blobs.find(ids.get<std::string>());
    return found == blobs.end() ? Value() : Value::binary(std::move(found->second));
  }
  Value list = Value::array();
  for (const Value& id : ids) list.push_back(blobsOf(id, blobs));
  return list;
}

/** Replace references by the blobs: `key*` becomes `key`. */
void attach(Value& value, BlobsById& blobs) {
  if (value.is_object()) {
    std::vector<std::string> keys;
    for (const auto& [key, item] : value.items()) {
      if (isReference(key)) keys.push_back(key);
    }
    for (const std::string& key : keys) {
      value[key.substr(0, key.size() - 1)] = blobsOf(value[key], blobs);
      value.erase(key);
    }
  }
  if (value.is_structured()) {
    for (Value& each : value) attach(each, blobs);
  }
}

void nameToNumber(Value& value) {
  if (value.is_structured()) {
    for (Value& each : value) nameToNumber(each);
  } else if (value.is_string()) {
    const auto& text = value.get_ref<const std::string&>();
    if (text == "NaN") value = std::numeric_limits<double>::quiet_NaN();
    else if (text == "Infinity") value = std::numeric_limits<double>::infinity();
    else if (text == "-Infinity") value = -std::numeric_limits<double>::infinity();
  }
}

std::string messageOf(Value data) {
  Value frame{{"type", "DM"}};
  frame["data"] = std::move(data);
  return encode(frame);
}

bool endsWith(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

}  // namespace

std::size_t Encoded::size() const {
  std::size_t total = text.size();
  for (const Blob& blob : blobs) total += blob.bytes->size();
  return total;
}

std::string freshId() {
  thread_local std::mt19937_64 random{[] {
    std::random_device device;
    std::seed_seq seed{device(), device(), device(), device()};
    return std::mt19937_64(seed);
  }()};
  std::string id;
  for (int half = 0; half < 2; ++half) {
    std::uint64_t bits = random();
    for (int digit = 0; digit < 16; ++digit, bits >>= 4) id += "0123456789abcdef"[bits & 15];
  }
  return id;
}

std::string encode(const Value& frame) {
  try {
    return writeJson(frame);
  } catch (const Value::exception& error) {
    raise({"invalid_request", std::string("the value cannot be sent as JSON: ") + error.what()});
  }
}

Encoded encodeMessage(Value data, Value msg) {
  Encoded message;
  data["msg"] = std::move(msg);
  Detacher(message.blobs).detach(data);
  message.text = messageOf(std::move(data));
  return message;
}

Encoded encodeMessage(Value data, std::shared_ptr<const Bytes> msg) {
  const std::string id = freshId();
  data["msg*"] = id;
  return {messageOf(std::move(data)), {{id, std::move(msg)}}};
}

Value decode(PaddedText text) {
  Value frame = parseJson(text);
  if (!frame.is_object() || !frame.contains("data")) {
    raise({"invalid_request", "the server sent a frame that is not a JSON object with data"});
  }
  return frame;
}

std::set<std::string> references(const Value& value) {
  std::set<std::string> found;
  collect(value, found);
  return found;
}

Value contentOf(Value data, BlobsById blobs) {
  if (!data.contains("msg") && !data.contains("msg*")) {
    raise({"conversion", "a message for " + textOf(data, "iTag") + " has neither msg nor msg*"});
  }
  if (!blobs.empty()) attach(data, blobs);
  Value content = std::move(data["msg"]);
  if (!endsWith(textOf(data, "type"), "/String")) nameToNumber(content);
  return content;
}

std::string textOf(const Value& object, const char* key) {
  if (!object.is_object()) return "";
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : "";
}

ErrorInfo errorOf(const Value& frame) {
  const auto error = frame.find("error");
  if (error == frame.end() || !error->is_object()) return {"error", textOf(frame, "data")};
  ErrorInfo info{textOf(*error, "code"), textOf(*error, "message"), textOf(*error, "item"), textOf(*error, "field")};
  if (error->contains("fields")) info.fields = (*error)["fields"];
  return info;
}

}  // namespace rce::detail

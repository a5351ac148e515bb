// Conversion between values and frames: JSON, blobs, NaN and infinities.
#pragma once

#include <map>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "json.hpp"
#include "rce/errors.hpp"

namespace rce::detail {

struct Blob {
  std::string id;  // 32 hex digits
  std::shared_ptr<const Bytes> bytes;
};

/** A text frame and its blobs. */
struct Encoded {
  std::string text;
  std::vector<Blob> blobs{};

  std::size_t size() const;
};

using BlobsById = std::map<std::string, Bytes>;

/** 32 random hex digits. */
std::string freshId();

/** Encode a frame without blobs. Throws InvalidRequest for text that is not UTF-8. */
std::string encode(const Value& frame);

/** Encode a DM with these `data`, and `msg` as its content. */
Encoded encodeMessage(Value data, Value msg);

/** The same with bytes as the content, which are not copied. */
Encoded encodeMessage(Value data, std::shared_ptr<const Bytes> msg);

/** Parse a text frame. Throws InvalidRequest if it is not a JSON object. */
Value decode(PaddedText text);

/** The ids of all blobs to which a value refers. */
std::set<std::string> references(const Value& value);

/** The content of a DM: bytes in place of blobs, numbers for the names of NaN and infinities except in Strings. */
Value contentOf(Value data, BlobsById blobs);

/** The error in an ER frame. */
ErrorInfo errorOf(const Value& frame);

/** The item of an object as text, or an empty text. */
std::string textOf(const Value& object, const char* key);

}  // namespace rce::detail

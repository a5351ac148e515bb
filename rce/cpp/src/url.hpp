// URLs of entries and endpoints, and what their queries contain.
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace rce::detail {

using Query = std::vector<std::pair<std::string, std::string>>;

struct Url {
  bool isSecure;
  std::string host;
  std::string port;
  std::string path;

  /** Parse a URL of one of two schemes, as `http` and `https`. Throws InvalidRequest. */
  static Url parse(const std::string& text, const std::string& plain, const std::string& secure);

  /** The path with a query, which is percent-encoded. */
  std::string target(const Query& query) const;

  /** Host and port as the header `Host` has them. */
  std::string authority() const;
};

/** The lower-case hex SHA-256 of a text. */
std::string sha256(const std::string& text);

}  // namespace rce::detail
